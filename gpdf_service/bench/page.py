"""`gpdf bench page`: how long an operator waits in a real browser, from the press of a button to the answer.

Service, page and browser are begun anew; the first press comes as soon as the map is on the screen, others follow. The
browser keeps the time: from opening the link until the map is there, and from the press until the page shows the
answer, with which the path is sent, and until that is drawn. Without a graphics card most of it is drawing: a frame
waits for the one before.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from gpdf_service.bench.report import Row, each, show
from gpdf_service.bench.running import Running, serving
from gpdf_service.errors import ConfigError
from gpdf_service.ports import free_port
from gpdf_service.types import FloatArray

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
"""Drawing without a graphics card."""
SIZE = {"width": 1440, "height": 900}
PATIENCE_MS = 120_000
DRAWN = """
() => [...document.querySelectorAll('input')].some(one => one.value === 'office')
  && !document.body.innerText.includes('office: ')
"""
"""A scene is chosen, and nothing of it is on its way."""
FRAMES = "for (let i = 0; i < 3; i++) await new Promise(requestAnimationFrame);"
"""What is known to the page is drawn in the next frame, and only then the one after it begins."""
ON_SCREEN = f"async () => {{ {FRAMES} return performance.now(); }}"
FIRST_S, LATER_S = 1.0, 0.2
"""[s] What nobody minds, for the first path of a fresh service and for others."""
UNANSWERED = "() => !document.body.innerText.includes('Answer after')"
WATCH = """
patience => {
  const button = [...document.querySelectorAll('button')].find(one => one.innerText === 'Take what is typed');
  window.answered = new Promise((done, failed) => button.addEventListener('click', () => {
    setTimeout(() => failed(new Error(`the page shows no answer after ${patience} ms`)), patience);
    const began = performance.now();
    new MutationObserver((_, observer) => {
      if (!document.body.innerText.includes('Answer after')) return;
      observer.disconnect();
      const answered = performance.now() - began;
      (async () => { FRAMES done([answered, performance.now() - began]); })();
    }).observe(document.body, {subtree: true, childList: true, characterData: true});
  }, {once: true, capture: true}));
}
""".replace("FRAMES", FRAMES)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--restarts", type=int, default=5, help="services, pages and browsers begun anew")
    parser.add_argument("--count", type=int, default=10, help="plans of each after the first")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if the first answers come within a second, and the median of the others within a fifth of one."""
    browser = next((found for name in CHROMIUM if (found := shutil.which(name))), None)
    if browser is None:
        raise ConfigError("bench page", "there is no Chromium on the PATH", "Install it: apt-get install chromium.")
    if args.restarts < 1 or args.count < 1:
        raise ConfigError("bench page", "there is nothing to measure", "Give --restarts and --count 1 or more.")
    opened, first, later = list[FloatArray](), list[FloatArray](), list[FloatArray]()
    for _ in each(range(args.restarts), "browsers"):
        with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as service:
            took = press_all(service, Path(folder), browser, 1 + args.count)
        opened.append(took[:1])
        first.append(took[1:2])
        later.append(took[2:])
    kinds = ("opened", opened), ("first", first), ("later", later)
    rows = [_row(name, np.concatenate(some)) for name, some in kinds]
    show(rows, as_json=args.json)
    return 0 if rows[1]["worst_s"] <= FIRST_S and rows[2]["p50_s"] <= LATER_S else 1


def press_all(service: Running, folder: Path, browser: str, count: int) -> FloatArray:
    """Open the page, then ask for the way there and back in turn, `count` times.

    Returns:
        For each the browser's time until it is answered and until it is drawn, and the processor's of page and service
        [s], shape (1 + count, 3).
    """
    from playwright.sync_api import sync_playwright

    there = [", ".join(f"{value:.3f}" for value in end[:2]) for end in (service.start, service.goal)]
    with viewing(service.endpoint, folder) as (page, url), sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser, args=list(FLAGS))
        web = chromium.new_context(viewport=SIZE).new_page()  # type: ignore[arg-type]
        both = service.process.pid, page.pid
        before = _worked(both)
        web.goto(url)
        web.get_by_text("Connected to").first.wait_for(timeout=PATIENCE_MS)
        web.wait_for_function(DRAWN, timeout=PATIENCE_MS)
        opened = float(web.evaluate(ON_SCREEN)) / 1000.0
        took = [
            (opened, opened, _worked(both) - before),
            *(_press(web, there[:: 1 - 2 * (i % 2)], both) for i in range(count)),
        ]
        chromium.close()
    return np.array(took)


@contextmanager
def viewing(endpoint: str, folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`gpdf view` as its own process, and its link."""
    words = ["view", "--endpoint", endpoint, "--port", str(free_port())]
    command = [sys.executable, "-m", "gpdf_service.cli", *words]
    with (
        (folder / "view.log").open("w") as said,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=said, text=True) as process,
    ):
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline().split()[-1]
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(PATIENCE_MS / 1000)


def _press(web: Any, ends: list[str], processes: tuple[int, ...]) -> tuple[float, float, float]:  # noqa: ANN401 - of playwright
    web.get_by_role("button", name="Clear").dispatch_event("click")  # whether or not the picture stands still
    web.wait_for_function(UNANSWERED, timeout=PATIENCE_MS)
    for name, text in zip(("Start", "Goal"), ends, strict=True):
        field = web.get_by_label(name, exact=True).first
        field.fill(text)
        field.press("Enter")
    web.wait_for_timeout(500)  # a person's hand goes from the keyboard to the mouse
    web.evaluate(WATCH, PATIENCE_MS)
    before = _worked(processes)
    web.get_by_role("button", name="Take what is typed").dispatch_event("click")
    answered, drawn = web.evaluate("() => window.answered")
    return answered / 1000.0, drawn / 1000.0, _worked(processes) - before


def _worked(processes: tuple[int, ...]) -> float:
    """Processor time of processes and their children [s]."""
    mains = [psutil.Process(pid) for pid in processes]
    return sum(sum(one.cpu_times()[:2]) for main in mains for one in (main, *main.children(recursive=True)))


def _row(which: str, took: FloatArray) -> Row:
    wall, drawn, cpu = took.T
    return {
        **{"waits": which, "count": len(took), "p50_s": float(np.median(wall)), "worst_s": float(wall.max())},
        **{"drawn_p50_s": float(np.median(drawn)), "drawn_worst_s": float(drawn.max())},
        **{"cpu_p50_s": float(np.median(cpu)), "cpu_worst_s": float(cpu.max())},
    }
