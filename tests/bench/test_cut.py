import json

import pytest

from gpdf_service.cli import main

pytestmark = pytest.mark.slow


def test_a_client_behind_a_cut_link_is_answered_again(capsys):
    assert main(["bench", "cut", "--seconds", "0.2", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["link"], row["status"]) for row in rows] == [("closed", "OK"), ("silent", "OK")]
    assert min(row["back_s"] for row in rows) > 0.0


def test_others_are_served_beside_hostile_clouds(capsys):
    main(["bench", "hostile", "--served", "--count", "4", "--json"])  # how long they wait is the machine's affair, too
    (row,) = json.loads(capsys.readouterr().out)
    assert row["clouds"] == row["built"] + row["refused_in_words"] == 4
    assert row["refused_in_words"] > 0
    assert row["plans_quiet"] == 40
    assert row["plans_beside"] >= 4
    assert row["ratio"] == pytest.approx(row["beside_p99_ms"] / row["quiet_p99_ms"])


def test_beside_clients_that_read_nothing_others_are_answered(capsys):
    assert main(["bench", "unread", "--seconds", "3", "--clients", "1", "--json"]) == 0
    quiet, beside = json.loads(capsys.readouterr().out)
    assert (quiet["unread"], beside["unread"]) == (0, 1)
    assert beside["plans"] > 0
    assert beside["max_ms"] < 60_000
