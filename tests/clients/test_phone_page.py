"""The phone's page in a Chromium whose WebXR is emulated (iwer): a walk over two storeys; without network; axe-core.

`npm --prefix tests/phone ci` brings what it needs; `make test-page` does so.
"""

import json
import math
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from gpdf_client import Client
from gpdf_guidance import Guide, Planner, Walker
from gpdf_guidance.alignment import AHEAD
from gpdf_guidance.catalogue import LANGUAGES, language
from gpdf_guidance.live import LiveGuide
from gpdf_guidance.walker import Errors
from gpdf_schemas import CueAction, CueMessage, decode, keys

from gpdf_service.bench.walks import WalkedWorld
from gpdf_service.ports import free_endpoint
from gpdf_service.service.server import Options, Server
from gpdf_service.synthetic.house import make_house

pytestmark = [pytest.mark.slow, pytest.mark.browser]
sync_api = pytest.importorskip("playwright.sync_api")
pytest.importorskip("websockets")
MODULES = Path(__file__).parent.parent / "phone" / "node_modules"
IWER, AXE = MODULES / "iwer" / "build" / "iwer.min.js", MODULES / "axe-core" / "axe.min.js"
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
if not (IWER.is_file() and AXE.is_file() and CHROMIUM):
    pytest.skip("needs a Chromium and tests/phone/node_modules: make test-page", allow_module_level=True)

EMULATED = "window.device = new IWER.XRDevice(IWER.metaQuest3); window.device.installRuntime({forceInstall: true});"
FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
TURN, SHIFT = 1.0, (4.0, -7.0)
"""How the emulated tracking lies beside the scene: the page must find out."""
OUTAGES = 20
ECHOES = """
window.echoes = [];
window.heard = take;
let sent = 0;
take = (message) => message.type === 'error' ? void echoes.push(1000 * (clock() - sent)) : heard(message);
setInterval(() => { sent = clock(); send({ type: 'echo' }); }, 50);
"""
"""What the guide's web socket answers at once goes the same way as a pose and its cue, without a guide in between."""
MADE_IN = 20.0
"""[ms] A cue, of a pose: nobody waits for a clock's tick."""
STEADY = Errors(drop_out_rate=0.0, position=0.0, heading=0.0)


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    made, folder = make_house(np.random.default_rng(1)), tmp_path_factory.mktemp("house")
    address = free_endpoint()
    with Server(Options(address, folder, folder, 1)), Client.connect(address) as client:
        client.load_scene("house", upload=made.points, ground=made.ground)
        client.set_place("house", "door", made.low.tolist())
        client.set_place("house", "bed", made.high.tolist())
        client.set_place("house", "stove", (made.low + np.array([1.0, 0.0, 0.0])).tolist())
        yield made, client, folder, address


@pytest.fixture
def served(house):
    """`gpdf guide … --phone` from the door to the bed, in a process of its own: its address, and what it says."""
    _, _, folder, address = house
    command = [sys.executable, "-m", "gpdf_service.cli", "guide", "house", "--goal", "bed", "--name", "anna", "--json"]
    command += ["--endpoint", address, "--phone", "--phone-host", "127.0.0.1", "--phone-port", "0", "--drift", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "HOME": str(folder)}) as guide:
        said = []
        url = json.loads(guide.stdout.readline())["url"]
        reader = threading.Thread(target=lambda: said.extend(json.loads(line)["text"] for line in guide.stdout))
        reader.start()
        yield url, said
        guide.terminate()
        reader.join(30)


@pytest.fixture
def guided(house, request):
    """A guide from the door to the bed, its page's address, and what happens to it."""
    from gpdf_guidance.phone import Phone, PhoneServer

    made, client, folder, _ = house
    stop, said = threading.Event(), []
    guide = Guide(Planner(client, "house"), made.high.tolist(), name="bed")
    phone = Phone(client.session, "anna", lambda: client.places("house"), "bed", getattr(request, "param", "en"), 0.0)
    live = LiveGuide(client.session, guide, "anna", lambda *sentence: said.append(sentence))
    with PhoneServer(phone, folder, "127.0.0.1") as server, ThreadPoolExecutor(1) as pool:
        running = pool.submit(live.run, stop.is_set, stays=True)
        yield guide, server, said
        stop.set()
        running.result(30)


@pytest.fixture
def opens():
    """Opens an address in a phone of which one side is emulated."""
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)

        def open_page(url, script=""):
            context = browser.new_context(
                viewport={"width": 390, "height": 844}, ignore_https_errors=True, bypass_csp=True, locale="en-GB"
            )
            context.add_init_script(path=str(IWER))
            context.add_init_script(EMULATED + script)
            opened = context.new_page()
            opened.goto(url)
            opened.wait_for_function("document.getElementById('place').options.length > 1")
            return opened

        yield open_page
        browser.close()


@pytest.fixture
def page(guided, opens):
    return opens(guided[1].url)


def hold(page, position, heading):
    """Put the emulated phone before a body in the scene."""
    x, y = position[0] + AHEAD * math.cos(heading) - SHIFT[0], position[1] + AHEAD * math.sin(heading) - SHIFT[1]
    u, v = x * math.cos(TURN) + y * math.sin(TURN), y * math.cos(TURN) - x * math.sin(TURN)
    yaw = heading - TURN - math.pi / 2
    place, turn = [u, 1.2 + float(position[2]), -v], [0.0, math.sin(yaw / 2), 0.0, math.cos(yaw / 2)]
    page.evaluate("([p, q]) => { device.position.set(...p); device.quaternion.set(...q); }", [place, turn])


def begin(page, made):
    """Stand at the door, face the stove, and press Start."""
    hold(page, made.low, 0.0)
    page.select_option("#place", "door")
    page.select_option("#facing", "stove")
    page.click("#start")
    page.wait_for_function("gpdf.said.some(one => one.text === 'Thank you.')")


def test_a_person_is_led_over_two_storeys_by_the_page(house, served, opens, tmp_path):
    made, client, _, _ = house
    page, said = opens(served[0]), served[1]
    world = WalkedWorld.of(made.points, made.ground)
    walker = Walker(made.low.copy(), 0.0, world.ground_height, np.random.default_rng(0), STEADY)
    cues = []

    def feel(sample):
        cues.append(decode(sample.payload.to_bytes(), CueMessage))
        walker.feel(cues[-1])

    subscriber = client.session.declare_subscriber(f"{keys.CUE}/anna", feel)
    page.screenshot(path=str(tmp_path / "before.png"))
    begin(page, made)
    page.evaluate(ECHOES)
    then, deepest, until = time.time(), 0.0, time.time() + 300
    while not (cues and cues[-1].action is CueAction.ARRIVED) and time.time() < until:
        now = time.time()
        for _ in range(max(1, round((now - then) / 0.05))):
            walker.move(now, 0.05)
            deepest = max(deepest, world.penetration(walker.position))
        then = now
        hold(page, walker.position, walker.heading)
        page.wait_for_timeout(30)
    subscriber.undeclare()
    page.screenshot(path=str(tmp_path / "after.png"), full_page=True)
    heard = [one["text"] for one in page.evaluate("gpdf.said")]
    print("\n".join(heard))
    late, echoes = (np.array(page.evaluate(name)) for name in ("gpdf.latency", "echoes"))  # on the page's own clock
    for name, found in (("pose to cue", late), ("echo", echoes)):
        print(f"{name}: p50 {np.median(found):.0f} ms, p99 {np.quantile(found, 0.99):.0f} ms of {len(found)}")
    print(f"screenshots in {tmp_path}")
    assert np.median(late) < np.median(echoes) + MADE_IN
    assert cues[-1].action is CueAction.ARRIVED, heard
    assert deepest == 0.0
    assert np.hypot(*(walker.position - made.high)[:2]) < 0.4
    assert abs(walker.position[2] - made.high[2]) < 0.05
    assert any("take the stairs up" in text for text in heard)
    assert heard[-1].startswith("Stop. You have arrived")
    assert set(said) >= set(heard) - {"Thank you.", "Stop. I have no connection."}


class Network:
    """Between the phone and the guide; while it is gone nothing comes through, and what waits comes after it."""

    def __init__(self, port):
        self.there, self._port = threading.Event(), port
        self.there.set()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        with suppress(OSError):
            while True:
                phone, guide = self._listener.accept()[0], socket.create_connection(("127.0.0.1", self._port))
                for a, b in ((phone, guide), (guide, phone)):
                    threading.Thread(target=self._pass_on, args=(a, b), daemon=True).start()

    def _pass_on(self, a, b):
        with suppress(OSError):
            while data := a.recv(65536):
                self.there.wait()
                b.sendall(data)
        with suppress(OSError):
            b.shutdown(socket.SHUT_WR)

    def close(self):
        self._listener.close()


@pytest.fixture
def network(guided):
    made = Network(guided[1].port)
    yield made
    made.there.set()
    made.close()


@pytest.fixture
def far_page(guided, network, opens):
    return opens(guided[1].url.replace(f":{guided[1].port}/", f":{network.port}/"))


def test_without_network_the_page_stops_the_person_by_itself_and_comes_back(house, network, far_page):
    page, took = far_page, []
    begin(page, house[0])
    page.evaluate("window.felt = []; navigator.vibrate = (pattern) => { felt.push(pattern); return true; }")
    for outage in [0.0] * (OUTAGES - 1) + [5.0]:
        before = page.evaluate("gpdf.cues")
        page.wait_for_function(f"gpdf.cues > {before + 10}")
        page.evaluate("felt.length = 0")
        network.there.clear()
        page.wait_for_function(f"gpdf.alone.length > {len(took)}")
        took.append(page.evaluate("gpdf.alone.at(-1)"))
        assert page.inner_text("#state") == "Stop. No connection."
        assert page.evaluate("gpdf.said.at(-1).text") == "Stop. I have no connection."
        assert [500, 100, 500] in page.evaluate("felt")
        page.wait_for_timeout(1000 * outage)
        assert page.inner_text("#state") == "Stop. No connection."
        network.there.set()
        page.wait_for_function("document.getElementById('state').textContent !== 'Stop. No connection.'")
    assert len(page.evaluate("gpdf.alone")) == OUTAGES
    print(f"stopped {min(took):.0f} to {max(took):.0f} ms after the last cue, {OUTAGES} times")


def test_what_the_network_brings_too_late_is_not_heard(house, page):
    begin(page, house[0])
    page.wait_for_function("gpdf.cues > 10")
    page.evaluate("socket.onmessage = null; window.before = [gpdf.cues, gpdf.said.length];")
    page.evaluate("take({type: 'cue', action: 'go', direction: 0, sent: clock() - 1, pose: clock() - 1})")
    page.evaluate("take({type: 'say', text: 'Go on.', urgency: 1, answers: [], until: clock() - 0.01})")
    assert page.evaluate("[gpdf.cues, gpdf.said.length]") == page.evaluate("before")
    page.evaluate("take({type: 'cue', action: 'go', direction: 0, sent: clock(), pose: clock()})")
    page.evaluate("take({type: 'say', text: 'Go on.', urgency: 1, answers: [], until: clock() + 1})")
    assert page.evaluate("gpdf.cues - before[0]") == 1
    assert page.inner_text("#words") == "Go on."


def test_the_page_is_accessible_and_its_buttons_are_large(page, tmp_path):
    page.add_script_tag(path=str(AXE))
    rules = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
    found = page.evaluate("rules => axe.run({runOnly: rules})", rules)
    print(f"axe-core: {len(found['passes'])} rules passed, {len(found['violations'])} violated")
    assert [(one["id"], one["help"]) for one in found["violations"]] == []
    boxes = "all => all.map(b => b.getBoundingClientRect()).map(r => [r.width, r.height])"
    sizes = page.eval_on_selector_all("button", boxes)
    assert all(height >= 44 for width, height in sizes if width)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    names = page.eval_on_selector_all("button:not([hidden])", "all => all.map(b => b.textContent.trim())")
    assert all(names)
    page.screenshot(path=str(tmp_path / "page.png"), full_page=True)
    print(json.dumps(names), tmp_path)


@pytest.mark.parametrize("guided", LANGUAGES, indirect=True)
def test_a_screen_reader_meets_all_of_the_page_in_the_guides_language(guided, page, request, tmp_path):
    tag = request.node.callspec.params["guided"]
    nodes = page.context.new_cdp_session(page).send("Accessibility.getFullAXTree")["nodes"]
    found = [
        (one["role"]["value"], one.get("name", {}).get("value", "").strip()) for one in nodes if not one["ignored"]
    ]
    print("\n".join(f"{role}: {name}" for role, name in found if role not in ("InlineTextBox", "StaticText")))
    page.screenshot(path=str(tmp_path / "page.png"), full_page=True)
    print(tmp_path)
    texts = language(tag).page
    by_role = {role: [name for other, name in found if other == role] for role, _ in found}
    asks = ("pause", "go_on", "repeat", "where", "around", "how_far", "slower", "faster", "more_words", "fewer_words")
    assert by_role["heading"] == [texts[name] for name in ("title", "stand", "ask", "voice")]
    assert by_role["button"] == [texts[name] for name in ("start", *asks, "listen", "lead")]
    assert by_role["combobox"] == [texts[name] for name in ("at", "facing", "goal")]
    assert by_role["checkbox"] == [texts["reader"]]
    assert [texts["choose"]] == sorted(set(by_role["option"]) - {"bed", "door", "stove"})
    assert len(by_role["status"]) == 1  # what the cue says is read out when it changes


def test_asks_are_buttons_and_answers_are_shown(house, guided, page):
    begin(page, house[0])
    page.wait_for_function("gpdf.said.some(one => one.text.startsWith('Bed: walk'))", timeout=60_000)
    page.dispatch_event("[data-ask=how_far]", "click")  # the emulator lies over the page
    page.wait_for_function("gpdf.said.some(one => one.text.includes('more to the goal'))", timeout=30_000)
    page.dispatch_event("[data-ask=pause]", "click")
    page.wait_for_function("gpdf.said.some(one => one.text.startsWith('Wait here.'))", timeout=30_000)
    page.wait_for_function("document.getElementById('state').dataset.cue === 'stop'")


EAR = """
window.SpeechRecognition = window.webkitSpeechRecognition = class {
  start() {
    const results = [utterance.map((transcript) => ({ transcript }))];
    setTimeout(() => { this.onresult({ results }); over = true; }, 50);
  }
};
"""
"""A recogniser of which a test says what it has heard: this Chromium has no microphone and no service for one."""


def test_what_stands_on_a_button_may_be_spoken_and_a_part_of_a_sentence_is_no_answer(house, guided, opens):
    page = opens(guided[1].url, EAR)
    page.evaluate("() => { window.asked = []; ask = (what) => { asked.push(what); }; }")

    def spoken(*heard):
        page.evaluate("heard => { window.utterance = heard; window.over = false; }", list(heard))
        page.dispatch_event("#listen", "click")
        page.wait_for_function("over")
        return page.evaluate("asked.splice(0)")

    assert page.is_visible("#listen")
    assert spoken("how far") == ["how_far"]
    assert spoken("Wear am eye", "where am I") == ["where"]  # of some alternatives one
    assert spoken("Go on.") == ["go_on"]
    assert spoken("yes") == []  # nothing was asked
    page.evaluate("document.getElementById('question').hidden = false")
    assert spoken("Yes or no") == []  # the question itself
    assert page.evaluate("gpdf.said.at(-1).text").startswith("I did not understand")
    assert spoken("Yes.") == ["yes"]
    page.evaluate("setTimeout(() => speak('Go on.', 1), 20)")
    assert spoken("go on") == []  # the page has heard itself


def test_without_tracking_the_page_says_so(guided):
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        opened = browser.new_context(ignore_https_errors=True, bypass_csp=True).new_page()
        opened.goto(guided[1].url)
        opened.wait_for_function("document.getElementById('place').options.length > 1")
        opened.click("#start")
        opened.wait_for_function("gpdf.said.some(one => one.text.startsWith('Choose two places'))")
        opened.select_option("#place", "door")
        opened.select_option("#facing", "stove")
        opened.click("#start")
        opened.wait_for_function("gpdf.said.some(one => one.text.includes('does not tell where the phone is'))")
        browser.close()
