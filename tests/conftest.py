import gc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

import gpdf_service as gpdf
from gpdf_service import ports
from gpdf_service.synthetic import SCENES

gc.set_threshold(50_000)
"""New objects after which one looks for garbage, as `gpdf` has it; by default that is a fifth of collecting tests."""

SCANS = Path(__file__).parent.parent.parent / "shared" / "data"

settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("search", max_examples=3000, deadline=None)
settings.load_profile("same")
"""The same examples in every run and on a slow machine; `--hypothesis-profile search` looks for new ones."""

LONGEST = (
    "clients/test_guide.py",
    "test_kernel_cache.py",
    "perception/test_storeys.py",
    "test_update.py",
    "clouds/test_formats.py",
    "search/test_moved.py",
    "synthetic/test_made_places.py",
    "test_noise.py",
    "search/test_graph.py",
    "service/test_status.py",
    "denoise/test_denoise.py",
    "clients/test_robot.py",
)
"""Of the modules without their slow tests."""


def pytest_collection_finish():
    """What stands now stands to the end: no search for garbage goes through it."""
    gc.freeze()


def pytest_collection_modifyitems(items):
    """The longest modules first: on several cores nobody then waits for one that began last."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    long = {Path(__file__).parent / name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (long.get(item.path, len(long)), item.path not in slow))


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
    """The synthetic office and its scene, built from its true labels; every test that plans in it adds to it."""
    made = SCENES["office"](np.random.default_rng(0), spacing=0.05)
    return made, gpdf.build_scene(made.points, made.ground)


@pytest.fixture(scope="session")
def office_file(tmp_path_factory):
    """The same scene as a file, with no body's free space in it, whatever was planned before."""
    made = SCENES["office"](np.random.default_rng(0), spacing=0.05)
    path = tmp_path_factory.mktemp("office") / "office.gpdf"
    gpdf.build_scene(made.points, made.ground).save(path)
    return path


@pytest.fixture
def free_endpoint():
    return ports.free_endpoint()
