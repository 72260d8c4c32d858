"""Scenes on disk and in memory: what was acknowledged is there after a crash; memory is bounded."""

import contextlib
import ctypes
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
import zenoh
from gpdf_client import Client, ServiceError
from gpdf_client.results import ClientError
from gpdf_schemas import Cylinder, MovingObstacle

import gpdf_service as gpdf
import gpdf_service.errors
from gpdf_service.search.ways import Prefer
from gpdf_service.service.memory import held_bytes
from gpdf_service.service.scene_files import SceneFiles
from gpdf_service.service.scenes import Shelf
from gpdf_service.service.server import Options, Server
from gpdf_service.tiles import HeightMap
from gpdf_service.tiles.surface import INFERRED


def floor(width):
    x, y = np.meshgrid(np.arange(0, width, 0.05), np.arange(0, 3, 0.05))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("floors")
    for i, width in enumerate((3.0, 4.0, 5.0)):
        gpdf.build_scene(floor(width)).save(folder / f"{i}.gpdf")
    return folder


def filled(files, state, **options):
    shelf = Shelf(files, state_dir=state, **options)
    for i in range(3):
        shelf.load_file(str(i), f"{i}.gpdf")
    shelf.settle()
    return shelf


def test_scenes_leave_memory_and_come_back_the_same(files, tmp_path):
    shelf = filled(files, tmp_path)
    sizes = [held_bytes(shelf.get(str(i)).scene) for i in range(3)]
    digests = [shelf.get(str(i)).scene.digest for i in range(3)]
    shelf.close()
    shelf = filled(files, tmp_path / "again", memory_bytes=max(sizes) * 1.1)

    def kept():
        return [str(i) for i in range(3) if shelf.get(str(i)).scene is not None]

    assert kept() == ["2"]
    for i in (0, 2, 1):
        scene = shelf.scene(shelf.get(str(i)))
        assert scene.digest == digests[i]
        assert scene.version == shelf.facts()[str(i)]["version"]
        assert gpdf.plan(scene, (0.5, 1.5), (2.0, 1.5), "roomba").status == "OK"
        assert kept() == [str(i)]
        assert shelf.facts()[str(i)]["in_memory"]
    shelf.close()


def test_many_threads_use_more_scenes_than_fit(files, tmp_path):
    shelf = filled(files, tmp_path, memory_bytes=1)
    wrong = []

    def use(i):
        for _ in range(10):
            scene = shelf.scene(shelf.get(str(i)))
            if scene.points[:, 0].max() < 2.9 + i:
                wrong.append(i)

    threads = [threading.Thread(target=use, args=(i % 3,)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not wrong
    assert not any(thread.is_alive() for thread in threads)
    shelf.close()


def test_the_free_spaces_of_many_bodies_are_let_go(files, tmp_path):
    shelf = filled(files, tmp_path)
    scene = shelf.scene(shelf.get("2"))
    bare = held_bytes(scene)
    scene.free_space("roomba")
    assert held_bytes(scene) > bare
    shelf._held.memory_bytes = bare
    shelf.trim()
    assert held_bytes(scene) == bare
    shelf.close()


def test_the_bodies_that_were_used_last_stay_and_so_do_their_ways(files, tmp_path):
    """A guide asks for a dozen: when all were dropped with the oldest, each of its ways built all of them again."""
    shelf = filled(files, tmp_path)
    scene = shelf.scene(shelf.get("2"))
    for agent in ("roomba", "spot", "human", "roomba"):  # a roomba's level ground is its own: it takes no step
        scene.ways(agent, Prefer.COMPANION)
    ways = {agent: scene.ways(agent, Prefer.COMPANION) for agent in ("human", "roomba")}
    while "spot" in scene.info()["agents_ready"]:  # its own, and that of its level ground
        shelf._held.memory_bytes = held_bytes(scene) - 1
        assert shelf.trim() <= shelf._held.memory_bytes
    assert scene.info()["agents_ready"] == ["human", "roomba"]
    assert all(scene.ways(agent, Prefer.COMPANION) is kept for agent, kept in ways.items())
    shelf._held.memory_bytes = 1
    shelf.trim()
    assert scene.info()["agents_ready"] == []
    shelf.close()


def test_memory_that_two_arrays_share_counts_once():
    array = np.zeros(1000)
    assert held_bytes([array, array[::2], {"a": array.reshape(10, 100)}, 5, "x"]) == 8000


def test_what_a_surface_keeps_of_what_it_was_asked_counts():
    surface = HeightMap(np.zeros(2), 0.1, np.zeros((100, 100), np.float32), np.full((100, 100), INFERRED))
    assert held_bytes(surface) + surface.inferred.nbytes == held_bytes(surface)


def test_what_is_made_of_a_scene_and_what_moves_there_counts_and_leaves_memory_with_it(files, tmp_path):
    shelf = filled(files, tmp_path)
    door = MovingObstacle(id="door", cylinder=Cylinder((1.5, 1.5, 0.0), 0.1, 1.8), lifetime_s=3600)

    def plan(name):
        scene = shelf.moving.merged(name, shelf.scene(shelf.get(name)))
        assert gpdf.plan(scene, (0.5, 1.5), (2.5, 1.5), "human").status == "OK"

    for name in "012":
        shelf.moving.publish(name, [door])
        plan(name)
    held, door_bytes = (shelf._held.entries, shelf.moving), 3 * shelf.moving.living("0")["door"].points.nbytes
    assert held_bytes(held) - door_bytes <= shelf.trim()
    shelf._held.memory_bytes = 1.1 * held_bytes(shelf.get("2").scene)
    for name in "012":
        plan(name)
        shelf.trim()
        assert held_bytes(held) - door_bytes <= shelf._held.memory_bytes
    shelf._held.memory_bytes = 1  # of the last one its bodies
    before, alone = held_bytes(held), shelf.trim()
    assert held_bytes(held) - door_bytes <= alone < 0.5 * before
    assert shelf.moving.living("2")  # it is still there
    shelf.close()


ARENAS = """
import ctypes, sys, threading
from gpdf_service.service.memory import share_one_arena

if sys.argv[2:] == ["one"]:
    share_one_arena()
libc, together = ctypes.CDLL(None), threading.Barrier(8)
threads = [threading.Thread(target=lambda: (libc.malloc(1000), together.wait())) for _ in range(8)]
for thread in threads:
    thread.start()
libc.fopen.restype = ctypes.c_void_p
file = ctypes.c_void_p(libc.fopen(sys.argv[1].encode(), b"w"))
libc.malloc_info(0, file)
libc.fclose(file)
"""


def test_threads_that_share_one_arena_do_not_keep_one_each(tmp_path):
    def arenas(*words):
        subprocess.run([sys.executable, "-c", ARENAS, str(tmp_path / "told"), *words], check=True)
        return (tmp_path / "told").read_text().count("<heap nr")

    if not hasattr(ctypes.CDLL(None), "malloc_info"):
        pytest.skip("needs glibc")
    assert arenas() > arenas("one") == 1


def test_what_was_ready_is_ready_again_and_versions_go_on(files, tmp_path):
    shelf = filled(files, tmp_path)
    before = {name: (facts["version"], facts["digest"]) for name, facts in shelf.facts().items()}
    shelf.unload("1")
    del before["1"]
    last = max(version for version, _ in before.values())
    shelf.close()
    again = Shelf(files, state_dir=tmp_path)
    again.restore()
    again.settle()
    assert {name: (facts["version"], facts["digest"]) for name, facts in again.facts().items()} == before
    again.load_file("1", "1.gpdf")
    again.settle()
    assert again.facts()["1"]["version"] > last
    again.close()


def test_a_version_that_was_unloaded_is_not_given_again_after_a_restart(tmp_path):
    files = SceneFiles(tmp_path)
    first = files.next_version(1)
    assert SceneFiles(tmp_path).next_version(1) == first + 1


def test_a_new_version_takes_the_place_of_the_old_on_disk(files, tmp_path):
    shelf = filled(files, tmp_path)
    shelf.load_file("0", "1.gpdf")
    shelf.settle()
    assert [path.name for path in tmp_path.glob("0@*")] == [f"0@{shelf.facts()['0']['version']}.gpdf"]
    shelf.close()


def test_a_scene_that_is_replaced_all_the_time_can_always_be_loaded_again(files, tmp_path):
    shelf = filled(files, tmp_path, memory_bytes=1)
    done, wrong = threading.Event(), []

    def use():
        while not done.is_set():
            for name in "012":  # each pushes the others out
                try:
                    shelf.scene(shelf.get(name))
                except gpdf.errors.SceneFileError as error:
                    wrong.append(error)

    threads = [threading.Thread(target=use) for _ in range(2)]
    for thread in threads:
        thread.start()
    for i in range(40):
        shelf.load_file("0", f"{i % 3}.gpdf")
    shelf.settle()
    done.set()
    for thread in threads:
        thread.join(60)
    assert not wrong
    assert sum(path.suffix == ".gpdf" for path in tmp_path.iterdir()) == 3
    shelf.close()


def test_what_a_crash_left_half_written_is_swept_away(files, tmp_path):
    filled(files, tmp_path).close()
    (tmp_path / ".0@9.gpdf.tmpabc").write_bytes(b"half")
    (tmp_path / "0@0.gpdf").write_bytes(b"the version before, not yet deleted")
    again = Shelf(files, state_dir=tmp_path)
    again.restore()
    again.settle()
    assert {facts["state"] for facts in again.facts().values()} == {"ready"}
    assert sorted(path.name for path in tmp_path.glob("*@*")) == [again.get(str(i)).file.name for i in range(3)]
    assert not list(tmp_path.glob(".*"))
    again.close()


def test_a_damaged_file_is_told_and_the_others_are_there(files, tmp_path):
    shelf = filled(files, tmp_path)
    shelf.close()
    shelf.get("0").file.write_bytes(b"damaged")
    again = Shelf(files, state_dir=tmp_path)
    again.restore()
    again.settle()
    states = {name: facts["state"] for name, facts in again.facts().items()}
    assert states == {"0": "failed", "1": "ready", "2": "ready"}
    assert "damaged" in again.get("0").error
    again.close()


def test_a_scene_whose_file_was_spoiled_while_it_was_out_of_memory_is_a_typed_error(files, tmp_path, free_endpoint):
    with Server(Options(free_endpoint, files, tmp_path, 1)) as server, Client.connect(free_endpoint) as client:
        client.load_scene("0", "0.gpdf")
        entry = server.shelf.get("0")
        entry.scene = None
        entry.file.write_bytes(b"spoiled")
        with pytest.raises(ServiceError, match="BUILD_FAILED"):
            client.plan("0", (0.5, 1.5), (2.0, 1.5), "roomba")


@pytest.mark.slow
def test_every_acknowledged_scene_is_there_after_a_kill_in_mid_build(files, tmp_path, free_endpoint, office):
    def serve():
        words = [sys.executable, "-m", "gpdf_service.cli", "serve", "--endpoint", free_endpoint]
        words += ["--log-dir", str(tmp_path), "--scenes-dir", str(files)]
        return subprocess.Popen(words, stderr=subprocess.DEVNULL)

    with serve() as process:
        try:
            with Client.connect(free_endpoint, timeout_s=60) as client:
                before = {str(i): client.load_scene(str(i), f"{i}.gpdf")["version"] for i in range(3)}
                large = np.concatenate([office[0].points + np.array([0, 0, 0.0005 * i]) for i in range(8)])
                threading.Thread(target=lambda: _try(client, large), daemon=True).start()
                while "large" not in client.scenes():
                    pass
                process.kill()
        finally:
            process.kill()
    with serve() as process:
        try:
            with Client.connect(free_endpoint, timeout_s=60) as client:
                assert {name: client.wait_for_scene(name)["version"] for name in before} == before
                assert client.plan("0", (0.5, 1.5), (2.0, 1.5), "roomba", deadline_s=300.0).status == "OK"
            process.send_signal(signal.SIGTERM)
            assert process.wait(60) == 0
        finally:
            process.kill()


def _try(client, points):
    with contextlib.suppress(ClientError, zenoh.ZError):  # it is killed, or the test ends
        client.load_scene("large", upload=points)
