import json
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.browser]


def test_presses_in_a_real_browser_are_answered_and_timed(browser):
    words = ["bench", "page", "--restarts", "1", "--count", "2", "--json"]
    done = subprocess.run([sys.executable, "-m", "gpdf_service.cli", *words], stdout=subprocess.PIPE, timeout=600)
    first, later = json.loads(done.stdout)  # whether they are in time, the machine decides
    assert (first["plans"], first["count"], later["plans"], later["count"]) == ("first", 1, "later", 2)
    assert 0.0 < first["cpu_p50_s"] < 1.0
    assert 0.0 < later["p50_s"] <= later["worst_s"]
