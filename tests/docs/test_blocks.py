"""Every block of Python and every command in the README and the site runs, page by page, as a reader would.

A page is one session in one folder, beside a real service with the scenes `office` and `stair`. A command that goes on
until it is stopped (serve, view, ros2, a guide or a drive that awaits poses) must be there and then end by SIGINT.
What several pages begin with, as `gpdf demo`, is run for the first of them; the others go on from what it left.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from blocks import ROOT, blocks_of, pages
from forked import forking
from gpdf_client import Client, UnavailableError

from gpdf_service.cli import find_verb
from gpdf_service.ports import free_endpoint
from gpdf_service.service.options import gather
from gpdf_service.service.server import Options, Server
from gpdf_service.synthetic import SCENES
from gpdf_service.synthetic.world import World

NOT_RUN = {
    "make test": "it is what runs this",
    "git clone": "this is the clone",
    "docker": "tests/docker",
    "sudo": "changes the machine",
    "pip install": "tests/packaging",
    "cd ": "the session is there already",
}
"""Commands by what they begin with, that a page shows and that are not run here, and why."""
STAYS = re.compile(r"gpdf (serve(?!.*--print-config)|view|ros2|(guide|drive)(?!.*--simulate))")
"""Commands that go on until they are stopped."""
SHELLS = ("console", "bash", "")
LINKED = ("docker", "clients")
"""Folders of the repository that a reader has."""
WAIT_S = 60
SILENT_S = 5
"""[s] For what may have nothing to say: that it is still there afterwards is what counts."""
PAGES = [page for page in pages() if any(block.language in ("python", *SHELLS) for block in blocks_of(page))]


@pytest.fixture(scope="module")
def clouds(tmp_path_factory):
    """What a reader has: the demo's office, the stair, and a cloud without labels."""
    folder = tmp_path_factory.mktemp("clouds")
    (folder / "out").mkdir()
    for name in ("office", "stair"):
        made = SCENES[name](np.random.default_rng(0))
        labels = {"label": made.ground.astype("i4"), "classes": np.array(["other", "ground"])}
        np.savez(folder / "out" / f"{name}.npz", xyz=made.points.astype("f4"), **labels)
    import open3d

    room, _ = World((6.0, 5.0, 2.7), ()).sample(0.05, np.random.default_rng(0), 0.0)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(room))
    open3d.io.write_point_cloud(str(folder / "YOUR_CLOUD.ply"), cloud)
    return folder


@pytest.fixture(scope="module")
def service(clouds, tmp_path_factory):
    """The endpoint of a running service."""
    scenes = [(name, clouds / "out" / f"{name}.npz") for name in ("office", "stair")]
    endpoint = free_endpoint()
    with Server(Options(endpoint, clouds / "out", tmp_path_factory.mktemp("log"), 1), scenes):
        with Client.connect(endpoint) as client:
            for name, _ in scenes:
                client.wait_for_scene(name, timeout_s=WAIT_S)
        yield endpoint


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    """The folder of what a reader types."""
    with forking(tmp_path_factory.mktemp("programs")) as folder:
        yield folder


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """What the first commands of a session printed, and the folder as they left it, by their text."""
    return tmp_path_factory.mktemp("begun"), {}


class Session:
    """A reader's folder and shell."""

    def __init__(self, folder, service, programs, begun):
        self.folder, self.own = folder, free_endpoint()
        self.left, self.begun = begun
        self.fresh = True
        self.swaps = [("tcp/127.0.0.1:7447", service), (r"tcp/(MAP|0\.0\.0\.0):7447", self.own)]
        paths = [ROOT, ROOT / "clients", ROOT / "schemas"]
        self.environment = os.environ | {
            "GPDF_ENDPOINT": service,
            "PYTHONPATH": os.pathsep.join(map(str, paths)),
            "PATH": os.pathsep.join([str(programs), str(Path(sys.executable).parent), os.environ["PATH"]]),
            "HOME": str(folder),
            "GPDF_WORKERS": "1",  # what a page shows does not hang on how many processes plan
        }
        self.started = []

    def swap(self, text):
        for old, new in self.swaps:
            text = re.sub(old, new, text)
        return text.replace(".venv/bin/", "").replace("make demo", "gpdf demo --out out")

    def python(self, block):
        self.fresh = False
        done = subprocess.run(
            ["bash", "-c", 'exec python -c "$0"', self.swap(block.text)],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=WAIT_S,
        )
        assert done.returncode == 0, f"line {block.line}\n{block.text}\n{done.stderr}"

    def shell(self, block):
        """The commands of a block; in one where lines begin with `$`, the others are output."""
        lines = block.text.splitlines()
        typed = [line[2:].partition("  #")[0].strip() for line in lines if line.startswith("$ ")]
        kept = [line for line in typed if not any(line.startswith(start) for start in NOT_RUN)]
        at_once = [line for line in kept if not STAYS.search(line)]
        if at_once:
            done = self.run("set -e\n" + "\n".join(map(self.swap, at_once)))
            assert (done.returncode != 0) == block.fails, f"line {block.line}\n{block.text}\n{done.stdout}{done.stderr}"
            assert "Traceback" not in done.stderr
        for line in kept:
            if STAYS.search(line):
                self.start(line)

    def run(self, script):
        first, self.fresh = self.fresh, False
        if first and script in self.begun:
            done, left = self.begun[script]
            shutil.copytree(left, self.folder, dirs_exist_ok=True)
            return done
        words = ["bash", "-c", script]
        done = subprocess.run(
            words, cwd=self.folder, env=self.environment, capture_output=True, text=True, timeout=3 * WAIT_S
        )
        if first:
            left = self.left / str(len(self.begun))
            shutil.copytree(self.folder, left, ignore=shutil.ignore_patterns(*LINKED))
            self.begun[script] = done, left
        return done

    def start(self, line):
        """Start what goes on, and wait until it answers, or does its work for a moment."""
        self.fresh, environment = False, dict(self.environment)
        serves = "gpdf serve" in line
        if serves:
            environment["GPDF_ENDPOINT"] = endpoint = self.own if "7447" in line else free_endpoint()
            environment |= {"GPDF_LOG_DIR": f"log{len(self.started)}", "GPDF_SCENES_DIR": "."}
        log = (self.folder / f"stays{len(self.started)}.log").open("w+")
        process = subprocess.Popen(
            ["bash", "-c", f"exec {self.swap(line)}"], cwd=self.folder, env=environment, stdout=log, stderr=log
        )
        self.started.append((line, process, log))
        if serves and "--zenoh" not in line:
            self.await_ready(process, endpoint, planner="--map" not in line)
        else:
            self.await_words(process, Path(log.name), WAIT_S if serves else SILENT_S)
        assert process.poll() is None, f"{line} ended\n{Path(log.name).read_text()}"

    def await_ready(self, process, endpoint, planner):
        until = time.monotonic() + WAIT_S
        while process.poll() is None and time.monotonic() < until:
            try:
                with Client.connect(endpoint, timeout_s=1) as client:
                    found = client.status()
                    if (
                        found
                        and all(one.ready for one in found)
                        and (not planner or any(one.role != "map" for one in found))
                    ):
                        return
            except UnavailableError:
                pass
            time.sleep(0.2)

    def await_words(self, process, log, seconds):
        """Until it says something, which it does at work."""
        until = time.monotonic() + seconds
        while process.poll() is None and not log.stat().st_size and time.monotonic() < until:
            time.sleep(0.05)

    def end(self):
        """SIGINT, as a person ends it; a service and a page end well by it."""
        for line, process, log in reversed(self.started):
            alive = process.poll() is None
            process.send_signal(signal.SIGINT)
            try:
                code = process.wait(timeout=WAIT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
            said = Path(log.name).read_text()
            assert alive, f"{line} ended by itself\n{said}"
            assert "Traceback" not in said, f"{line}\n{said}"
            if "gpdf serve" in line:
                assert code == 0, f"{line}\n{said}"


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_what_a_page_shows_runs(page, clouds, service, programs, begun, tmp_path):
    folder = tmp_path / "reader"
    shutil.copytree(clouds, folder)
    for name in LINKED:
        (folder / name).symlink_to(ROOT / name)
    session = Session(folder, service, programs, begun)
    try:
        for block in blocks_of(page):
            if block.language == "python":
                session.python(block)
            elif block.language in SHELLS:
                session.shell(block)
    finally:
        session.end()


def test_shown_settings_are_accepted(tmp_path):
    shown = [block for page in pages() for block in blocks_of(page) if block.language == "toml"]
    assert shown
    for block in shown:
        file = tmp_path / "gpdf.toml"
        file.write_text(block.text)
        gather(file, {}, {})


def test_shown_commands_are_known_to_their_verbs():
    """Those in the running text."""
    for page in pages():
        for found in re.findall(r"`(?:\.venv/bin/)?gpdf ([^`]*)`", page.read_text()):
            words = shlex.split(found.replace("…", "").replace("|", " ").replace("*", ""))
            assert find_verb(words) or words[0] in ("--help", "VERB"), f"{page.name}: gpdf {found}"


def test_readme_is_short_and_has_a_picture():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 150
    (picture,) = re.findall(r"!\[[^]]*]\(([^)]*)\)", text)
    assert (ROOT / picture).is_file()
