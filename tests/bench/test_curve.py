import json
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
import pytest

from gpdf_service.bench.curve import END, WIDTH, build_hall
from gpdf_service.cli import main
from gpdf_service.pipeline import plan
from gpdf_service.types import Status


@pytest.fixture(scope="module")
def curve(tmp_path_factory):
    picture = tmp_path_factory.mktemp("curve") / "curve.png"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gpdf_service.bench.plan.REPEATS", 1)
        patch.setattr("gpdf_service.bench.curve.CLUTTER", (10.0,))
        patch.setattr("gpdf_service.bench.curve.MEDIUM", 30.0)
        with redirect_stdout(StringIO()) as said:
            assert main(["bench", "plan", "--curve", "30", "--json", "--plot", str(picture)]) == 0
    return json.loads(said.getvalue()), picture


def test_the_curve_has_paths_maps_and_clutter_and_every_path_is_found(curve):
    rows, picture = curve
    assert [row["sweep"] for row in rows] == ["path", "path", "map", "clutter"]
    assert all(row["ok"] == row["queries"] > 0 for row in rows)
    assert all(row["walked_m"] >= row["asked_m"] for row in rows)
    assert all(row["cpu_ms"] > 0 for row in rows)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_wall_lengthens_the_way_so_that_no_path_is_straight():
    ends = (END, WIDTH / 2), (29.0, WIDTH / 2)
    with_walls, without = (build_hall(30.0, every, np.random.default_rng(0)) for every in (4.0, 1000.0))
    ways = [plan(scene, *ends, "human") for scene in (with_walls, without)]
    assert [way.status for way in ways] == [Status.OK] * 2
    assert ways[0].trajectory.length > 1.1 * ways[1].trajectory.length
