"""Every example runs against a real service, with nothing of the server's to import."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gpdf_service.service.server import Options, Server

ROOT = Path(__file__).parent.parent.parent
EXAMPLES = sorted((ROOT / "clients" / "examples").glob("*.py"))


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory, office):
    import socket

    folder = tmp_path_factory.mktemp("scenes")
    office[1].save(folder / "office.gpdf")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with Server(Options(address, folder, tmp_path_factory.mktemp("log"), 2)) as server:
        server.shelf.load_file("office", "office.gpdf")
        while server.shelf.get("office").building:
            time.sleep(0.01)
        yield address


BLOCK = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"scipy", "numba", "open3d", "laspy", "mcap", "matplotlib", "gpdf_service"}:
            raise ImportError(f"{name} is not in the light install")
sys.meta_path.insert(0, Absent())
import runpy
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_with_the_light_install_alone(endpoint, example):
    words = [sys.executable, "-c", BLOCK, str(example), endpoint]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    if example.stem == "plan":
        assert done.stdout.startswith("OK")
    if example.stem == "guide":
        assert done.stdout.strip().endswith("arrived")
    if example.stem == "distance":
        assert "known: [ True False]" in done.stdout
    if example.stem == "upload":
        assert "22500 points" in done.stdout or "15000 points" in done.stdout
        assert done.stdout.strip().endswith("OK")


def test_the_examples_are_short():
    assert EXAMPLES
    for path in EXAMPLES:
        assert len(path.read_text().splitlines()) <= 20


def test_upload_parts_are_small_enough_for_one_request():
    from gpdf_client.client import PART_POINTS
    from gpdf_schemas import MAX_REQUEST_BYTES, Array, UploadRequest, encode

    part = UploadRequest(
        scene="a" * 64,
        upload_id="b" * 32,
        part=0,
        parts=1,
        points=Array.pack(np.zeros((PART_POINTS, 3))),
        ground=Array.pack(np.zeros(PART_POINTS), "f4"),
    )
    assert len(encode(part)) < MAX_REQUEST_BYTES
