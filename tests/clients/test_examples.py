"""Every example runs against a real service, with nothing of the server's to import."""

import json
import shutil
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from gpdf_client import Client
from gpdf_guidance import Guide, Planner
from gpdf_guidance.live import LiveGuide

from gpdf_service.ports import free_endpoint
from gpdf_service.service.server import Options, Server

ROOT = Path(__file__).parent.parent.parent
EXAMPLES = sorted((ROOT / "clients" / "examples").glob("*.py"))


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory, office_file):
    folder = tmp_path_factory.mktemp("scenes")
    shutil.copy(office_file, folder / "office.gpdf")
    address = free_endpoint()
    with Server(Options(address, folder, tmp_path_factory.mktemp("log"), 1)) as server:
        server.shelf.load_file("office", "office.gpdf")
        server.shelf.settle()
        until = time.monotonic() + 300
        while not server.status().ready:  # its kernels are there, too
            assert time.monotonic() < until
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


SAID = {
    "asynchronous": ["roomba OK", "spot ", "pepper ", "human OK"],
    "credentials": ["['office'"],
    "distance": ["known: [ True False]"],
    "drawing": ["10000 points between", "leaves of free space"],
    "drive": ["arrived", "routes: 1"],
    "errors": ["GOAL_OUTSIDE_MAP", "another scene: UNKNOWN_SCENE", "another request: INVALID_REQUEST"],
    "guide": ["arrived"],
    "obstacles": ["cut by dog after", "round it"],
    "places": [
        "entrance at [1.0, 1.0], kitchen at [5.0, 3.3]\nOK",
        "UNKNOWN_PLACE: there is no place 'kitchen'",
        "Known: entrance",
    ],
    "phone": ["where am I: "],
    "plan": ["OK", "m of room"],
    "scenes": ["copy version", "points on 1 level", "digest"],
    "services": ["is there: ", "healthy: True ready: True"],
    "trajectory": ["where after 2 s", "the first 1.00 m take"],
    "update": ["heard of growing with", "points\nwithout it: "],
    "upload": ["15000 points", "\nOK\n"],
}
"""What each example prints; one without an entry fails."""


@pytest.fixture
def guided(endpoint):
    """A guide of the person that the example of a phone is, through the office."""
    stop = threading.Event()
    with Client.connect(endpoint) as client, ThreadPoolExecutor(1) as pool:
        guide = Guide(Planner(client, "office"), [5.4, 3.4])
        running = pool.submit(LiveGuide(client.session, guide, "anna", lambda *_: None).run, stop.is_set, stays=True)
        yield endpoint
        stop.set()
        running.result(30)


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_with_the_light_install_alone(endpoint, example, request):
    if example.stem == "phone":
        request.getfixturevalue("guided")
    words = [sys.executable, "-c", BLOCK, str(example), endpoint]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    for words in SAID[example.stem]:
        assert words in done.stdout


def test_the_examples_are_short():
    assert EXAMPLES
    for path in EXAMPLES:
        most = 30 if path.stem == "phone" else 20  # nothing of ours is imported there
        assert 12 <= len(path.read_text().splitlines()) <= most


NOT_SHOWN = {
    "ask",  # the base of the others
    "ask_planner",
    "session",  # shown by gpdf_robot.live
    "close",  # `with` calls it
    "positions",
    "headings",
    "arc_lengths",
}


def test_every_public_call_has_an_example():
    from gpdf_client import AsyncClient, Client, Trajectory

    shown = "\n".join(path.read_text() for path in EXAMPLES)
    for kind in (Client, AsyncClient, Trajectory):
        for name in vars(kind):
            if not name.startswith("_") and name not in NOT_SHOWN:
                assert f".{name}" in shown, f"{kind.__name__}.{name} has no example"


LIGHT = """
import sys, time
def resident():
    return next(int(line.split()[1]) / 1024 for line in open("/proc/self/status") if line.startswith("VmRSS"))
bare, began = resident(), time.process_time()
import gpdf_client
imported = time.process_time() - began
with gpdf_client.Client.connect(sys.argv[1]) as client:
    assert client.plan("office", (1, 1), (5, 3.3)).trajectory is not None
    print(imported, resident() - bare, *sorted({name.partition(".")[0] for name in sys.modules}))
"""


def test_the_light_client_is_light(endpoint, capsys):
    done = subprocess.run([sys.executable, "-c", LIGHT, endpoint], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    seconds, megabytes, *modules = done.stdout.split()
    with capsys.disabled():
        print(f"\nlight client: {float(seconds):.2f} s of CPU to import, {float(megabytes):.0f} MB more after a plan")
    assert float(megabytes) <= 60.0
    assert not {"scipy", "numba", "open3d", "mcap", "matplotlib", "gpdf_service"} & set(modules)


def test_a_program_that_forgets_to_close_ends(endpoint):
    code = "import sys, gpdf_client; client = gpdf_client.Client.connect(sys.argv[1]); print(sorted(client.scenes()))"
    done = subprocess.run([sys.executable, "-c", code, endpoint], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "office" in done.stdout


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


@pytest.mark.slow
def test_the_command_line_saves_a_trajectory(endpoint, tmp_path, capsys):
    from gpdf_client import Trajectory

    from gpdf_service.cli import main

    words = ["client", "--endpoint", endpoint, "plan", "office", "--start", "1,1", "--goal", "5,3.3", "--json"]
    assert main([*words, "--save", str(tmp_path / "path.json")]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert Trajectory.load(tmp_path / "path.json").positions.tolist() == printed["positions"]
    assert main([*words, "--save", str(tmp_path / "path.xml")]) == 1
    assert "saved as" in capsys.readouterr().err
