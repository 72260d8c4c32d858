"""The operator's page in all its states, on a desk and on a phone, with what axe-core finds in each: `make screens`."""

from __future__ import annotations

import argparse
import json
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from gpdf_client import Client
from gpdf_schemas import CueAction, CueMessage, PoseMessage, encode, keys
from playwright.sync_api import Page as Tab
from playwright.sync_api import sync_playwright

import gpdf_service as gpdf
from gpdf_service.bench.page import FLAGS, viewing
from gpdf_service.ports import free_endpoint
from gpdf_service.search.free_space import find_reach
from gpdf_service.service.begun import begun
from gpdf_service.synthetic import SCANNERS, SCENES
from gpdf_service.synthetic.places import PLACES

SIZES = {"desk": (1440, 900), "phone": (390, 844)}
WAIT_MS = 240_000
"""For one thing to appear, drawn by software beside other work."""
STILL_MS = 4_000
"""A picture is drawn by software, frame by frame."""
AXE = Path(__file__).parent.parent.parent / "tests" / "phone" / "node_modules" / "axe-core" / "axe.min.js"
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
VOXEL = 0.05
"""[m] Of the house's scan."""


@dataclass(frozen=True)
class Stage:
    """A browser at the page, and where one can walk in each scene: start and goal as one types them."""

    web: Tab
    client: Client
    ends: dict[str, tuple[str, str]]

    def opens(self, scene: str) -> None:
        """Show a scene, its lowest storey, and no path."""
        if self._field("Scene").input_value() != scene:
            self._choose("Scene", scene)
        self.web.wait_for_function(DRAWN, arg=scene, timeout=WAIT_MS)
        self.presses("Clear")

    def plans(self, start: str, goal: str) -> None:
        """Type two places, and wait for the answer."""
        for name, text in (("Start", start), ("Goal", goal)):
            self._field(name).fill(text)
        self.presses("Take what is typed")
        self.sees("Answer after")

    def presses(self, name: str) -> None:
        """A button, wherever the panel is scrolled."""
        self.web.get_by_role("button", name=name, exact=True).dispatch_event("click")

    def sees(self, text: str) -> None:
        """Wait for a text."""
        self.web.get_by_text(text).first.wait_for(timeout=WAIT_MS)

    def storey(self, number: int) -> None:
        """Show a storey: the lowest is 0, −1 is all of them."""
        self._field("Storey").click()
        self.web.get_by_role("option").nth(number).click()

    def slides(self, label: str, value: float) -> None:
        """Set a slider, and wait until what it moves is drawn."""
        self._field(label).fill(f"{value:g}")
        self._field(label).press("Enter")
        self.web.wait_for_timeout(STILL_MS)

    def _choose(self, label: str, value: str) -> None:
        self._field(label).click()
        self.web.get_by_role("option", name=value, exact=True).click()

    def _field(self, label: str):  # noqa: ANN202 - of playwright
        return self.web.get_by_text(label, exact=True).first.locator("xpath=following::input[not(@type='hidden')][1]")


AGAIN_S = 0.3
"""[s] Between two times that what moves says where it is."""
AT_REST = "() => !/^.*: .* …$/m.test(document.body.innerText)"
"""Nothing is on its way."""
DRAWN = """
scene => [...document.querySelectorAll('input')].some(one => one.value === scene)
  && !document.body.innerText.includes(`${scene}: `)
"""


def first(stage: Stage) -> None:
    """As the page opens."""


def plan(stage: Stage) -> None:
    """A path with its clearance."""
    stage.plans(*stage.ends["office"])


def error(stage: Stage) -> None:
    """A goal in a table."""
    stage.plans(stage.ends["office"][0], stage.ends["table"][1])
    stage.sees("No path")


def comparison(stage: Stage) -> None:
    """The paper's four methods."""
    stage.plans(*stage.ends["office"])
    stage.presses("Compare the methods")
    stage.sees("least clearance [m]")


def moving(stage: Stage) -> Callable[[], None]:
    """A guided person and a robot on their way, who say so until the picture is taken."""
    stage.plans(*stage.ends["office"])

    def say() -> None:
        stamp = time.time() + AHEAD_S
        for name, place, turn in (("anna", [2.0, 1.6, 0.0], 0.6), ("robot-2", [4.2, 2.6, 0.0], -2.4)):
            pose = PoseMessage(position=place, heading=turn, stamp=stamp)
            stage.client.session.put(f"{keys.POSE}/{name}", encode(pose))
        cue = CueMessage(action=CueAction.GO, direction=0.2, urgency=0.0, distance=3.1, stamp=stamp)
        stage.client.session.put(f"{keys.CUE}/anna", encode(cue))

    return say


AHEAD_S = 2.5
"""[s] A pose is shown for 3 s before and after its stamp: one of the near future stays until the picture is taken."""


def house(stage: Stage) -> None:
    """A way over two storeys, the lower one shown."""
    stage.opens("two-storeys")
    stage.plans(*stage.ends["two-storeys"])


def house_above(stage: Stage) -> None:
    """The same with all storeys."""
    house(stage)
    stage.storey(-1)


def house_apart(stage: Stage) -> None:
    """The storeys pulled apart."""
    house_above(stage)
    stage.slides("Pull apart [m]", 3)


def museum(stage: Stage) -> None:
    """A place of many storeys, and the way through them."""
    stage.opens("thirty-levels")
    stage.plans(*stage.ends["thirty-levels"])


def museum_apart(stage: Stage) -> None:
    """All its storeys, pulled apart."""
    museum(stage)
    stage.storey(-1)
    stage.slides("Pull apart [m]", 3)


STATES: dict[str, Callable[[Stage], Callable[[], None] | None]] = {
    state.__name__: state
    for state in (first, plan, error, comparison, moving, house, house_above, house_apart, museum, museum_apart)
}
OF_MUSEUM = "museum", "museum_apart"


def main() -> None:
    """Take them all; fails where axe-core finds fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/screens"))
    parser.add_argument("--museum", type=Path, help="a cloud of many storeys; the state is left out without it")
    parser.add_argument("--only", nargs="*", default=list(STATES), help=f"of {', '.join(STATES)}")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    found: dict[str, list[str]] = {}
    with TemporaryDirectory() as name, sync_playwright() as playwright:
        folder, endpoint = Path(name), free_endpoint()
        ends = make_scenes(folder, args.museum if {*OF_MUSEUM} & {*args.only} else None)
        scenes = [f"{path.stem}={path}" for path in sorted(folder.glob("*.gpdf"))]
        words = *scenes, "--endpoint", endpoint, "--scenes-dir", name, "--log-dir", f"{name}/log"
        with begun(folder / "serve.log", *words), Client.connect(endpoint, timeout_s=60) as client:
            for scene in client.scenes():
                client.wait_for_scene(scene)
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
            for state in args.only:
                for device in SIZES if state not in OF_MUSEUM or args.museum else ():
                    with viewing(endpoint, folder) as (_, url):
                        web = _arrive(browser, device, url)
                        again = STATES[state](Stage(web, client, ends))
                        found[f"{state}_{device}"] = _shoot(web, args.out / f"{state}_{device}.png", again)
                        web.context.close()
            browser.close()
    (args.out / "axe.json").write_text(json.dumps(found, indent=1))
    for name, faults in found.items():
        print(f"{name}: {'; '.join(faults) or 'no violation'}", flush=True)
    raise SystemExit(any(found.values()))


def make_scenes(folder: Path, museum: Path | None) -> dict[str, tuple[str, str]]:
    """Scene files, and where one starts and goes to in each."""
    made = SCENES["office"](np.random.default_rng(0))
    gpdf.build_scene(made.points, made.ground).save(folder / "office.gpdf")
    ends = {"office": (typed(made.start), typed(made.goal)), "table": ("", "2.7, 0.45, 0")}
    rng = np.random.default_rng(3)
    place = PLACES["house_return"](rng)
    scan = SCANNERS["handheld"](place, rng, 0.006).thinned(VOXEL, rng)
    gpdf.build_scene(scan.points).save(folder / "two-storeys.gpdf")
    ends["two-storeys"] = typed(place.way[0]), typed(place.way[-1])
    if museum is not None:
        scene = gpdf.build_scene(gpdf.read_cloud(museum).points)
        reach = find_reach(scene.free_space("human"))
        scene.save(folder / "thirty-levels.gpdf")
        ends["thirty-levels"] = typed(reach.start), typed(reach.goal)
    return ends


def typed(place: np.ndarray) -> str:
    """A place as one types it."""
    return ", ".join(f"{value:.2f}" for value in place)


def _arrive(browser, device: str, url: str) -> Tab:  # noqa: ANN001 - of playwright
    width, height = SIZES[device]
    web = browser.new_context(viewport={"width": width, "height": height}).new_page()
    web.set_default_timeout(WAIT_MS)
    web.goto(url)
    web.get_by_text("Connected to").first.wait_for(timeout=WAIT_MS)
    web.wait_for_function(DRAWN, arg="office", timeout=WAIT_MS)
    web.locator("input[aria-label='Goal']").first.wait_for(state="attached", timeout=WAIT_MS)
    warning = web.locator(".mantine-Notification-closeButton")  # Chromium's, about drawing by software
    if warning.count():
        warning.first.dispatch_event("click")
        web.wait_for_function("!document.querySelector('.mantine-Notification-root')", timeout=WAIT_MS)
    return web


def _shoot(web: Tab, path: Path, again: Callable[[], None] | None) -> list[str]:
    """The picture, and what axe-core finds fault with. `again` is called until it is taken."""
    taken = threading.Event()
    if again is not None:
        threading.Thread(target=lambda: [again() for _ in iter(lambda: taken.wait(AGAIN_S), True)], daemon=True).start()
    web.wait_for_timeout(STILL_MS)
    web.wait_for_function(AT_REST, timeout=WAIT_MS)
    web.wait_for_timeout(STILL_MS)
    web.screenshot(path=str(path), timeout=WAIT_MS)
    taken.set()
    if not AXE.is_file():
        return ["axe-core is missing: npm --prefix tests/phone ci"]
    web.add_script_tag(path=str(AXE))
    found = web.evaluate("rules => axe.run({runOnly: rules})", RULES)
    return [f"{one['id']} ({one['impact']}) at {one['nodes'][0]['html'][:90]}" for one in found["violations"]]


if __name__ == "__main__":
    main()
