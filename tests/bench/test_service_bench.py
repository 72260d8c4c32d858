import json

import pytest

from gpdf_service.cli import main


@pytest.mark.slow
def test_the_bench_of_the_service_accounts_for_every_request(capsys, monkeypatch):
    monkeypatch.setattr("gpdf_service.bench.service.WARM_S", 0.2)
    few = ["--count", "3", "--seconds", "0.5", "--clients", "8", "--restarts", "1"]
    assert main(["bench", "service", *few, "--json"]) == 0
    wire, speed, crowd, first = json.loads(capsys.readouterr().out)
    assert wire["over_zenoh_p50_ms"] > 0
    assert speed["plans_per_s_1"] > 0
    assert speed["service_cpu_ms_1"] > speed["clients_cpu_ms_1"] > 0
    assert crowd["unanswered"] == 0
    assert crowd["asked"] == crowd["ok"] + crowd.get("busy", 0)
    assert 0 < crowd["ok_p50_ms"] <= crowd["ok_p99_ms"]
    assert first["restarts"] == 1
    assert first["first_over_tenth_max_ms"] == pytest.approx(first["first_max_ms"] - first["tenth_p50_ms"])
