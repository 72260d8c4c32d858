import json

import pytest

from gpdf_service.cli import main

pytestmark = [pytest.mark.slow, pytest.mark.browser]


def test_presses_in_a_real_browser_are_answered_and_timed(browser, capsys):
    main(["bench", "page", "--restarts", "1", "--count", "2", "--json"])  # whether it is in time, the machine decides
    first, later = json.loads(capsys.readouterr().out)
    assert (first["plans"], first["count"], later["plans"], later["count"]) == ("first", 1, "later", 2)
    assert 0.0 < first["cpu_p50_s"] < 1.0
    assert 0.0 < later["p50_s"] <= later["worst_s"]
