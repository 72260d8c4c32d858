"""A link that is cut and comes back: a proxy between client and service that lets nothing through for a while."""

import json
import time

import numpy as np
import pytest
import zenoh
from gpdf_client import Client
from gpdf_client.client import client_config

import gpdf_service as gpdf
from gpdf_service.bench.cut import Cable
from gpdf_service.service.network import session_config
from gpdf_service.service.server import Options, Server

BACK_S = 10.0
"""[s] In which the client is answered again, once the link is there: a third of a second on a quiet machine."""


@pytest.mark.slow
@pytest.mark.parametrize("closes", [True, False])
def test_a_link_that_was_cut_is_back_soon(tmp_path, free_endpoint, closes):
    x, y = np.meshgrid(np.arange(0, 3, 0.05), np.arange(0, 3, 0.05))
    gpdf.build_scene(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])).save(tmp_path / "room.gpdf")
    cable = Cable(int(free_endpoint.rpartition(":")[2]))
    with Server(Options(free_endpoint, tmp_path, tmp_path / "log", 1)), Client.connect(cable.endpoint) as client:
        client.load_scene("room", "room.gpdf")
        for seconds in (1.5, 4.0):
            cable.cut(closes=closes)
            time.sleep(seconds)
            cable.mend()
            assert client.plan("room", (0.5, 1.5), (2.0, 1.5), "roomba", deadline_s=BACK_S).status == "OK"
    cable.close()


def test_both_ends_notice_a_cut_soon_and_together_and_try_again_soon():
    """A lease that only one end shortens is worse than none: after 4 s of silence the other end is 9 s behind."""

    def of(config, key):
        return json.loads(config.get_json(key))

    ends, own = [client_config("tcp/127.0.0.1:7447"), session_config(Options("tcp/127.0.0.1:7447"))], zenoh.Config()
    leases = {of(end, "transport/link/tx/lease") for end in ends}
    assert len(leases) == 1
    assert max(leases) < of(own, "transport/link/tx/lease")
    for end in ends:
        assert of(end, "connect/retry")["period_max_ms"] < 1000.0
