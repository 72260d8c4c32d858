import json
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.browser]


def test_presses_in_a_real_browser_are_answered_and_timed(browser):
    words = ["bench", "page", "--restarts", "1", "--count", "2", "--json"]
    done = subprocess.run([sys.executable, "-m", "gpdf_service.cli", *words], stdout=subprocess.PIPE, timeout=600)
    opened, first, later = json.loads(done.stdout)  # whether they are in time, the machine decides
    assert [(row["waits"], row["count"]) for row in (opened, first, later)] == [
        ("opened", 1),
        ("first", 1),
        ("later", 2),
    ]
    assert first["p50_s"] < opened["p50_s"]
    assert 0.0 < first["cpu_p50_s"] < 1.0
    assert 0.0 < later["p50_s"] <= later["worst_s"]
    assert later["p50_s"] < later["drawn_p50_s"] <= later["drawn_worst_s"]


@pytest.mark.parametrize("words", [["--restarts", "0"], ["--count", "0"]])
def test_nothing_to_measure_is_said_in_words(words, browser):
    done = subprocess.run(
        [sys.executable, "-m", "gpdf_service.cli", "bench", "page", *words], capture_output=True, text=True
    )
    assert done.returncode != 0
    assert "Give --restarts and --count 1 or more" in done.stderr
    assert "Traceback" not in done.stderr
