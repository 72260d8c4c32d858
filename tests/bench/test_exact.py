"""What is told of places that touch something in the exact world."""

import numpy as np

from gpdf_service.bench.exact import count_touching
from gpdf_service.synthetic.solid_world import SolidWorld
from gpdf_service.synthetic.solids import box
from gpdf_service.types import AGENTS


def test_places_that_touch_something_are_told_apart_by_whether_the_scan_shows_it():
    floor = box("floor", (0, 0, -0.5), (6, 4, 0), walkable=True)
    seen, unseen = box("wall", (1, 0, 0), (1.1, 4, 2)), box("wall", (5, 0, 0), (5.1, 4, 2))
    points, ground = SolidWorld((floor, seen)).sample(0.03)
    places = np.array([[1.2, 2.0, 0.0], [1.25, 1.0, 0.0], [4.9, 2.0, 0.0], [3.0, 2.0, 0.0]])
    found = count_touching(SolidWorld((floor, seen, unseen)), places, AGENTS["human"], 0.002, points[~ground])
    assert found == {"wrongly_free": 3, "wrongly_free_seen": 2}
    found = count_touching(
        SolidWorld((floor, seen, unseen)), places, AGENTS["human"], 0.002, np.array([[3.0, 2.0, 1.0]])
    )
    assert found == {"wrongly_free": 3, "wrongly_free_seen": 0}
    found = count_touching(SolidWorld((floor,)), places, AGENTS["human"], 0.002, points[~ground])
    assert found == {"wrongly_free": 0, "wrongly_free_seen": 0}
