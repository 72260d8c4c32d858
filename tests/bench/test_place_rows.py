"""Rows of random places: labels and paths held against the exact world."""

from functools import cache

import pytest

from gpdf_service.bench import places
from gpdf_service.bench.places import label_rows, path_rows, shaft_rows
from gpdf_service.bench.rules import without
from gpdf_service.synthetic.places import supermarket


def test_labels_tell_a_ceiling_that_was_taken_for_the_floor(monkeypatch):
    monkeypatch.setattr(places, "scanned_place", cache(places.scanned_place))  # once for both
    (row,) = label_rows("handheld", 1, 3, makers=(supermarket,))
    with without("ceilings"):
        (other,) = label_rows("handheld", 1, 3, makers=(supermarket,))
    assert row["found_least"] > 0.9
    assert row["wrong_most"] < 0.05
    assert other["found_least"] < 0.1
    assert other["wrong_most"] > 0.9


def test_nobody_is_free_over_a_shaft_of_which_walls_alone_were_seen():
    (row,) = shaft_rows("tripod", 1, 1)
    with without("walls of pits"):
        (other,) = shaft_rows("tripod", 1, 1)
    assert row["free"] > 1000
    assert row["over_shaft"] == 0
    assert other["over_shaft"] > 100


@pytest.mark.slow
def test_no_path_among_shelves_touches_what_stands_beneath_them():
    rows = list(path_rows("handheld", 6, 1, makers=(supermarket,)))
    assert [row["agent"] for row in rows] == ["human", "roomba"]
    assert all(row["ok"] > 2 for row in rows)
    assert not any(row["collisions"] for row in rows)
