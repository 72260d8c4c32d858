import json
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest
from gpdf_schemas import PlanRequest, encode

from gpdf_service.cli import main
from gpdf_service.service.pool import Settings


@pytest.mark.slow
def test_what_was_warmed_once_is_not_compiled_again(capsys):
    assert main(["warm", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["compiled"] >= 0
    words = [sys.executable, "-m", "gpdf_service.cli", "warm", "--json"]
    again = subprocess.run(words, capture_output=True, text=True, check=True, timeout=600)
    assert json.loads(again.stdout)["compiled"] == 0
    found = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True, timeout=600)
    heaps, later = found.stdout.splitlines()
    assert {"attach", "steps_over_gaps", "whole_around", "ends_at", "grown_sheet"} <= set(heaps.split())
    assert later == "later:"


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["warm", "bench paper --jobs 2 --scene office --scene stair"])
def test_a_verb_that_is_killed_takes_its_processes_with_it(verb):
    words = [sys.executable, "-m", "gpdf_service.cli", *verb.split()]
    with subprocess.Popen(words, stderr=subprocess.DEVNULL) as warming:
        children, began = Path(f"/proc/{warming.pid}/task/{warming.pid}/children"), []
        while len(began) < 2:  # one process at the least, beside that which tracks what they share
            assert warming.poll() is None
            time.sleep(0.05)
            began = children.read_text().split()
        warming.kill()
    deadline = time.monotonic() + 60.0
    while any(Path(f"/proc/{one}").exists() for one in began) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [one for one in began if Path(f"/proc/{one}").exists()]


@pytest.mark.slow
def test_a_process_that_says_that_it_is_ready_has_loaded_what_its_first_plan_runs(tmp_path, office, office_file):
    made = office[0]
    ask = PlanRequest(scene="x", start=list(made.start), goal=list(made.goal), agent="human")
    (tmp_path / "plan").write_bytes(encode(ask))
    settings = msgspec.json.encode(Settings("me", 1e9, "text", ("human",))).decode()
    words = [sys.executable, "-c", FIRST, settings, str(office_file), str(tmp_path / "plan")]
    found = subprocess.run(words, capture_output=True, text=True, check=True, timeout=600)
    assert found.stdout.split() == ["OK"]


@pytest.mark.slow
def test_what_plans_run_is_loaded_before_the_first_of_them(office_file):
    """Whatever kind of answer it is."""
    found = subprocess.run(
        [sys.executable, "-c", PREPARED, str(office_file)], capture_output=True, text=True, check=True, timeout=600
    )
    assert found.stdout.splitlines() == ["OK NO_VALID_PATH GOAL_OCCUPIED", "later:"]


PREPARED = """
import sys
from gpdf_service.kernel_cache import kernels
from gpdf_service.pipeline import plan
from gpdf_service.scene import load_scene

def loaded():
    return {
        (one.__name__, signature)
        for package in ("search", "planning")
        for one in kernels(f"gpdf_service.{package}")
        for signature in one.signatures
    }

scene = load_scene(sys.argv[1])
for body in "human", "roomba":
    scene.prepare(body)
before, start = loaded(), (1.0, 1.0)
asked = ((5.4, 3.4), "human"), ((5.5, 1.94), "roomba"), ((0.33, 0.08), "human")
print(*(plan(scene, start, *one).status for one in asked))
print("later:", *sorted({name for name, _ in loaded() - before}))
"""
FIRST = """
import sys, time
from pathlib import Path
from gpdf_schemas import PlanReply, decode, keys
from gpdf_service.service import plan_process
from gpdf_service.service.pool import WARM, Ask
from gpdf_service.kernel_cache import kernels

def loaded():
    return {(one.__name__, signature) for one in kernels() for signature in one.signatures}

def serve(pipe, desk):
    file, request = sys.argv[2:]
    desk.answer(Ask(WARM, b"", time.monotonic(), 0.0, "x", file))
    before = loaded()
    ask = Ask(keys.PLAN, Path(request).read_bytes(), time.monotonic(), 0.0, "x", file)
    print(decode(desk.answer(ask), PlanReply).status, *(name for name, _ in loaded() - before))

plan_process.serve = serve
plan_process.prepare()
plan_process.main(None, sys.argv[1].encode())
"""
"""Instead of serving, a process takes a scene into memory, makes the first plan, and names the kernels it loaded."""
LOADED = """
from gpdf_service.kernel_cache import kernels
from gpdf_service.warm import Warming
Warming().plans()
assert len(list(kernels())) > 100
before = {one for one in kernels() if one.signatures}
Warming().heaps()
print(*(one.__name__ for one in kernels() if one.signatures and one not in before))

for step in Warming().steps().values():
    step()
import numpy as np
from dataclasses import replace
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.search.free_space import find_reach
from gpdf_service.synthetic import Box, World
from gpdf_service.synthetic.house import make_house
from gpdf_service.types import AGENTS

def loaded():
    return {(one.__name__, signature) for one in kernels() for signature in one.signatures}

before, rng, spot = loaded(), np.random.default_rng(1), replace(AGENTS["spot"], name="spot of discs", discs=6)
bend = World((5.0, 5.0, 1.2), (Box((0.0, 0.45, 0.0), (4.55, 5.0, 1.2)),))
assert plan(build_scene(*bend.sample(0.03, rng)), (0.8, 0.22), (4.78, 4.2), spot).details["cut_x"]
house = make_house(rng, 0.05)
eyes = np.broadcast_to(house.low + [0.0, 0.0, 1.5], house.points.shape)
scene = build_scene(house.points, house.ground, origins=eyes)
assert plan(scene, house.low, house.high).status == "OK"
scene.update(insert=house.low + [[1.5, 0.0, z] for z in (0.2, 0.4, 0.6)], origins=eyes[0])
build_scene(house.points + rng.normal(0.0, 0.02, house.points.shape), house.ground)
scene = build_scene(house.points, house.ground)
plan(scene, house.low, house.high)
plan(scene.update(insert=house.low + [[1.5, 0.0, z] for z in (0.2, 0.4, 0.6)]), house.low, house.high)
print("later:", *sorted({name for name, _ in loaded() - before}))
"""
"""What the heaps run that plans do not: none of it is compiled where somebody waits, or where memory is measured.

Then what discs that cannot turn, rays, labels in noise and a change load after all of that: nothing."""
