"""The delays of cues are measured over real Zenoh sessions."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from gpdf_service.bench.cues import Body
from gpdf_service.cli import main

pytestmark = pytest.mark.slow


def test_cues_are_measured_from_poses_and_from_obstacles(capsys, monkeypatch):
    monkeypatch.setattr("gpdf_service.bench.cues.OBSTACLES", 3)  # after each he is told for 4 s why he stood
    assert main(["bench", "guide", "--count", "1", "--scene", "stair", "--live", "2", "--json"]) == 0
    row, total = json.loads(capsys.readouterr().out)
    assert (row["arrived"], total["contacts"]) == (1, 0)
    assert row["cues"] > 10
    assert row["obstacles"] == 3
    assert row["cues_per_s"] >= row["cues"] / 2.0  # every cue is counted, also those that know no new pose
    delays = [row[name] for name in ("pose_to_cue_ms_p50", "pose_to_cue_ms_p99", "obstacle_to_stop_ms_max")]
    assert np.isfinite(delays).all()
    assert min(delays) > 0.0


def test_a_guide_that_lets_nobody_go_is_no_measurement(monkeypatch):
    monkeypatch.setattr("gpdf_service.bench.cues.TOLD_S", 0.05)
    body = Body(SimpleNamespace(declare_subscriber=lambda *_: None), np.zeros(4))
    with pytest.raises(TimeoutError, match="lets nobody go"):
        body.wait_to_go()
