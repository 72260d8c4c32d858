"""A bench that is killed leaves no service running."""

import subprocess
import sys
import time

import psutil
import pytest

from gpdf_service.service.begun import begun

PATIENCE_S = 120.0
"""[s] For what must happen at all."""


def service_of(bench):
    """The process of `gpdf serve` that a bench began."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        for child in psutil.Process(bench.pid).children():
            if "serve" in child.cmdline():
                return child
        time.sleep(0.05)
    raise AssertionError("no service was begun")


@pytest.mark.slow
@pytest.mark.parametrize("bench", ["crash", "cut"])
def test_a_bench_that_is_killed_takes_its_service_with_it(bench):
    words = [sys.executable, "-m", "gpdf_service.cli", "bench", bench]
    with subprocess.Popen(words, stderr=subprocess.DEVNULL) as process:
        service = service_of(process)
        process.kill()
    gone, alive = psutil.wait_procs([service], PATIENCE_S)
    for left in alive:
        left.kill()
    assert gone == [service]


def test_what_a_service_says_is_in_its_log_and_it_has_ended_afterwards(tmp_path):
    with begun(tmp_path / "said", "--endpoint", "none/none") as process:
        assert process.wait(PATIENCE_S) == 1
    assert "cannot listen on none/none" in (tmp_path / "said").read_text()
