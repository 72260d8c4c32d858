import pytest

from gpdf_service.bench.running import serving
from gpdf_service.bench.soak import soak


@pytest.mark.slow
def test_a_short_soak_fails_nothing_and_leaks_no_thread_or_file(tmp_path, monkeypatch):
    monkeypatch.setattr("gpdf_service.bench.soak.PLANNERS", 2)  # with three, half as many scenes come and go
    with serving(tmp_path) as service:
        row = soak(service, 10.0, 0)
    assert row["failed"] == 0
    assert min(row[what] for what in ("plans", "loads", "uploads", "unloads", "moves")) > 0
    assert row["answers"] >= row["plans"] + row["loads"] + row["uploads"] + row["unloads"]
    assert max(row["threads_grew"], row["files_grew"]) <= 3
