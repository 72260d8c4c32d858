import numpy as np
import pytest

from gpdf_service.bench.build_scale import hall, measure


def test_a_hall_has_its_points_half_of_them_floor_as_dense_as_asked():
    points = np.concatenate(list(hall(60_000, 0.05, np.random.default_rng(0))))
    assert len(points) == pytest.approx(60_000, rel=0.1)
    floor = np.abs(points[:, 2]) < 0.01
    assert floor.mean() == pytest.approx(0.5, abs=0.1)
    area = np.ptp(points[floor, 0]) * np.ptp(points[floor, 1])
    assert floor.sum() / area == pytest.approx(1.0 / 0.05**2, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("tiled", [False, True])
def test_a_build_is_measured_in_a_process_of_its_own(tiled):
    row = measure(60_000, tiled=tiled)
    assert row["points"] == pytest.approx(60_000, rel=0.1)
    assert row["kept"] < row["points"] if tiled else row["kept"] == row["points"]
    assert row["build_cpu_s"] > 0.0
    assert 0.05 < row["peak_gb"] < 4.0
