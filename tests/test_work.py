"""The bar of verbs that take longer: what a terminal shows, and how soon."""

import os
import pty
import re
import subprocess
import sys
import termios

import numpy as np
import pytest

from gpdf_service.cli import inputs, work
from gpdf_service.cli.work import Work
from gpdf_service.clouds.frame import UP

LIGHT = (
    "plan",
    "scene build",
    "scene info",
    "scene crop",
    "scene merge",
    "view",
    "client",
    "drive",
    "guide",
    "ros2",
)


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test turns."""
    now = [100.0]
    monkeypatch.setattr(work.time, "monotonic", lambda: now[0])
    return now


def test_what_is_left_is_told_by_the_share_that_is_done_and_counts_down(clock):
    made = Work("read", "build")  # one share and seven
    clock[0] += 5.0  # what is loaded first says nothing of the cloud
    with made.step("read"):
        assert made.left(clock[0]) is None
        clock[0] += 2.0
    with made.step("build") as progress:
        assert made.left(clock[0]) == pytest.approx(14.0)
        assert made.left(clock[0] + 4.0) == pytest.approx(10.0)
        clock[0] += 7.0
        progress("build levels", 0.5)
        assert made.left(clock[0]) == pytest.approx(7.0)
        assert made.left(clock[0] + 99.0) == 0.0


def test_a_step_that_is_left_out_is_not_waited_for(clock):
    made = Work("read", "build", "draw")
    with made.step("read"):
        clock[0] += 2.0
    with made.step("draw"):
        assert made.left(clock[0]) == pytest.approx(2.0 * 5 / 8)


@pytest.mark.parametrize("size", [(24, 80), (0, 0)])
def test_a_terminal_sees_each_stage_and_what_is_left(tmp_path, size):
    rows = np.random.default_rng(0).uniform([0.0, 0.0, 0.0], [4.0, 4.0, 0.01], (40_000, 3))
    np.savetxt(tmp_path / "floor.xyz", rows, fmt="%.4f")
    words = ["scene", "info", str(tmp_path / "floor.xyz"), "--agent", "human"]
    seen = on_a_terminal([sys.executable, "-m", "gpdf_service.cli", *words], size)
    stages = ["start", "read", "segment ground", "find where the body fits"]
    at = [seen.index(stage) for stage in stages]
    assert at == sorted(at)
    assert re.search(r"about \d+ s left", seen)


def test_a_place_that_is_made_shows_how_far_its_scan_is(tmp_path):
    words = ["synthetic", "crowd", "--scanner", "depth", "--thin", "0.1", "--out", str(tmp_path / "crowd.npz")]
    seen = on_a_terminal([sys.executable, "-m", "gpdf_service.cli", *words])
    stages = ["start", "cast rays", "write"]
    assert [seen.index(stage) for stage in stages] == sorted(seen.index(stage) for stage in stages)
    assert re.search(r"about \d+ s left", seen)


def test_a_bench_shows_how_much_of_it_is_done():
    words = ["bench", "field", "--surface", "plane", "--noise", "0", "--noise", "0.01", "--points", "2000"]
    seen = on_a_terminal([sys.executable, "-m", "gpdf_service.cli", *words, "--queries", "200"])
    assert re.search(r"field: .*1/2 ", seen)


HELPED = """
import sys
from contextlib import redirect_stderr, redirect_stdout, suppress
from io import StringIO
from gpdf_service.cli import main
for verb in sys.argv[1:]:
    for word in "--help", "--bogus":
        with suppress(SystemExit), redirect_stderr(StringIO()), redirect_stdout(StringIO()):
            main([*verb.split(), word])
    heavy = {"numba", "scipy", "open3d", "matplotlib"} & set(sys.modules)
    print(verb, *heavy, sep=",")
    for name in [name for name in sys.modules if name.partition(".")[0] in heavy]:
        del sys.modules[name]
"""
"""One process for all verbs: which heavy modules each loads."""


@pytest.fixture(scope="module")
def helped():
    words = [sys.executable, "-c", HELPED, *LIGHT]
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60)
    return {verb: heavy for verb, *heavy in (line.split(",") for line in done.stdout.splitlines())}


@pytest.mark.parametrize("verb", LIGHT)
def test_help_and_a_wrong_word_do_not_wait_for_what_plans(verb, helped):
    assert helped[verb] == []


def test_the_axes_that_the_command_line_knows_are_those_that_are_read():
    assert tuple(UP) == inputs.UP


def on_a_terminal(words, size=(24, 80)):
    """What a terminal shows of a command that succeeds, from first to last."""
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, size)
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=theirs)
    os.close(theirs)
    text = b""
    try:
        while part := os.read(ours, 4096):
            text += part
    except OSError:  # nobody holds its other end any more
        pass
    os.close(ours)
    assert process.wait(60) == 0, text.decode()
    return text.decode()
