import socket
from pathlib import Path

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.synthetic import SCENES

SCANS = Path(__file__).parent.parent.parent / "shared" / "data"


@pytest.fixture(scope="session")
def scan():
    """Path of a real scan; skips where they are not."""

    def find(name):
        path = SCANS / name
        if not path.is_file():
            pytest.skip(f"needs the scan {name}")
        return path

    return find


@pytest.fixture(scope="session")
def office():
    """The synthetic office and its scene, built from its true labels."""
    made = SCENES["office"](np.random.default_rng(0), spacing=0.05)
    return made, gpdf.build_scene(made.points, made.ground)


@pytest.fixture
def free_endpoint():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
