"""Two hosts, as network namespaces: the map service on one, a planner on the other; the link between them is cut."""

import contextlib
import itertools
import os
import queue
import shutil
import subprocess
import sys
import threading

import pytest

PATIENCE_S = 90
"""[s] For what must happen at all: the transport's lease is 10 s, a look at the map 5 s."""
MAP, PLANNER = "tcp/10.77.0.1:7447", "tcp/10.77.0.2:7448"

WALKER = """
import sys
from gpdf_client import Client, ClientError
endpoint, start, goal, deadline_s = sys.argv[1], eval(sys.argv[2]), eval(sys.argv[3]), float(sys.argv[4])
with Client.connect(endpoint, timeout_s=60) as client:
    while True:
        try:
            result = client.plan("office", start, goal, deadline_s=deadline_s)
            print(result.status, result.scene_version, flush=True)
        except ClientError as error:
            print(type(error).__name__, flush=True)
"""
LOADER = """
import sys
from gpdf_client import Client
with Client.connect(sys.argv[1]) as client:
    client.load_scene("office", "office.gpdf")
"""


def ip(*words):
    subprocess.run(["ip", *words], check=True, capture_output=True)


@pytest.fixture
def hosts():
    """Two namespaces with a cable between; yields how to run something on one, and how to set the cable up or down."""
    one, two = (f"gpdf{os.getpid()}{side}" for side in "ab")
    if not shutil.which("ip"):
        pytest.skip("needs the ip command")
    try:
        ip("netns", "add", one)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"needs the right to make network namespaces: {error.stderr.decode().strip()}")
    with contextlib.ExitStack() as stack:
        stack.callback(ip, "netns", "del", one)
        ip("netns", "add", two)
        stack.callback(ip, "netns", "del", two)
        ip("link", "add", "cable", "netns", one, "type", "veth", "peer", "name", "cable", "netns", two)
        for host, address in ((one, "10.77.0.1/24"), (two, "10.77.0.2/24")):
            ip("-n", host, "addr", "add", address, "dev", "cable")
            ip("-n", host, "link", "set", "lo", "up")
            ip("-n", host, "link", "set", "cable", "up")

        def run(host, *words, log=subprocess.DEVNULL):
            inside = ["ip", "netns", "exec", (one, two)[host], sys.executable, *words]
            process = subprocess.Popen(inside, stdout=subprocess.PIPE, stderr=log, text=True)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        yield run, lambda state: ip("-n", one, "link", "set", "cable", state)


class Walker:
    """A client that plans again and again, and what it sees."""

    def __init__(self, process):
        self._seen, self._told = queue.Queue(), []
        self._reader = threading.Thread(target=lambda: [self._seen.put(line.split()) for line in process.stdout])
        self._reader.start()

    def until(self, wanted):
        """All that it saw, to the first of the wanted kind."""
        seen = []
        while not seen or not wanted(seen[-1]):
            seen.append(self._seen.get(timeout=PATIENCE_S))
        self._told += seen
        return seen

    def story(self):
        """All that it told so far, in a line."""
        return ", ".join(f"{' '.join(what)} × {len(list(times))}" for what, times in itertools.groupby(self._told))


def is_ok(seen):
    return seen[0] == "OK"


@pytest.mark.slow
def test_a_cut_link_stops_those_beyond_it_alone_and_what_changed_meanwhile_is_there_afterwards(
    hosts, office, office_file, tmp_path
):
    run, cable = hosts
    made = office[0]
    shutil.copy(office_file, tmp_path / "office.gpdf")
    serve = ["-m", "gpdf_service.cli", "serve", "--scenes-dir", str(tmp_path), "--workers", "1"]
    places = [str(tuple(map(float, made.start))), str(tuple(map(float, made.goal)))]
    with (tmp_path / "serve.log").open("w") as log:
        first = [f"office={tmp_path}/office.gpdf", "--map", "--endpoint", MAP, "--log-dir", str(tmp_path / "a")]
        run(0, *serve, *first, log=log)
        second = ["--planner", "--endpoint", PLANNER, "--connect", MAP, "--log-dir", str(tmp_path / "b")]
        run(1, *serve, *second, log=log)
    far = Walker(run(0, "-c", WALKER, MAP, *places, "2"))  # beside the map service: its plans cross the cable
    near = Walker(run(1, "-c", WALKER, PLANNER, *places, "60"))  # beside the planner
    version = int(near.until(is_ok)[-1][1])
    far.until(is_ok)

    cable("down")
    far.until(lambda seen: seen[0] == "UnavailableError")
    assert run(0, "-c", LOADER, MAP).wait(PATIENCE_S) == 0  # the map changes where the planner cannot see it
    far.until(lambda seen: seen[0] == "UnavailableError")

    cable("up")
    back = near.until(lambda seen: is_ok(seen) and int(seen[1]) > version)
    assert {tuple(seen) for seen in back[:-1]} == {("OK", str(version))}  # all the time, from the planner's copy
    assert int(far.until(is_ok)[-1][1]) >= version
    far.until(lambda seen: is_ok(seen) and int(seen[1]) > version)
    print(f"\nacross the cable: {far.story()}\nbeside the planner: {near.story()}")  # with pytest -s
