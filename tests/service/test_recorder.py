"""The log in trouble: full disks, rotation, retention, repair. Real files, real disks, real processes."""

import json
import os
import resource
import shutil
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from gpdf_client import Client
from gpdf_schemas import Status, keys
from mcap.reader import make_reader

from gpdf_service.cli import main
from gpdf_service.service.record import BROKEN, check, prune, records_of, repair, repair_folder
from gpdf_service.service.recorder import Recorder
from gpdf_service.service.replay import recorded_plans
from gpdf_service.service.segment import Segment
from gpdf_service.service.server import Options, Server

BLOB = np.random.default_rng(0).bytes(20_000)  # does not compress


def messages(folder):
    return [
        message.data
        for path in sorted(folder.glob("*.mcap"))
        for record in [make_reader(path.open("rb"))]
        for _, _, message in record.iter_messages()
    ]


def test_a_log_goes_on_in_the_next_file_when_it_is_large_and_each_tells_of_itself(tmp_path):
    recorder = Recorder(Options(log_dir=tmp_path, log_segment_mb=0.05, log_sync="each"), "x", {"planner": "p"})
    recorder.scene("office", np.zeros((10, 3)), {"digest": "d"})
    sent = [bytes([i]) + BLOB for i in range(12)]
    for i, data in enumerate(sent):
        recorder.exchange("k", b"", data, i, i)
    recorder.close()
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) > 3
    for number, path in enumerate(files, 1):
        assert check(path).complete
        found = {record.name: record.metadata for record in make_reader(path.open("rb")).iter_metadata()}
        assert (found["gpdf"]["planner"], found["gpdf"]["segment"]) == ("p", str(number))
        assert json.loads(found["scene/office"]["facts"]) == {"digest": "d"}
    assert [data for data in messages(tmp_path) if data[1:] == BLOB] == sent


def test_a_scene_that_was_unloaded_is_not_in_the_next_file(tmp_path):
    recorder = Recorder(Options(log_dir=tmp_path, log_segment_mb=0.01, log_sync="each"), "x", {})
    recorder.scene("office", np.zeros((10, 3)), {})
    recorder.forget("office")
    recorder.exchange("k", b"", BLOB, 0, 0)
    recorder.exchange("k", b"", b"", 0, 0)
    recorder.close()
    last = sorted(tmp_path.glob("*.mcap"))[-1]
    assert [record.name for record in make_reader(last.open("rb")).iter_metadata()] == ["gpdf"]


def test_an_old_log_goes_on_in_the_next_file(tmp_path):
    recorder = Recorder(Options(log_dir=tmp_path, log_segment_s=1e-6, log_sync="each"), "x", {})
    for i in range(3):
        recorder.exchange("k", b"", b"", i, i)
    recorder.close()
    assert len(list(tmp_path.glob("*.mcap"))) >= 3


def test_each_message_is_on_the_disk_before_its_call_returns(tmp_path):
    recorder = Recorder(Options(log_dir=tmp_path, log_sync="each"), "x", {})
    for i in range(5):
        recorder.exchange("k", b"?", bytes([i]), i, i)
        data = [record.data for record in records_of(recorder.path) if type(record).__name__ == "Message"]
        assert data[-1] == bytes([i])  # as another process, or a machine after a loss of power, reads it
    recorder.close()


def test_the_oldest_logs_go_first_and_live_ones_never(tmp_path):
    live = Recorder(Options(log_dir=tmp_path), "live", {})
    os.utime(live.path, (0, 0))
    for i in range(5):
        path = tmp_path / f"gpdf_{i}.mcap{BROKEN if i == 1 else ''}"
        path.write_bytes(bytes(1000))
        os.utime(path, (1e9 + i, 1e9 + i))
    (tmp_path / "mine.mcap").write_bytes(b"")
    size = live.path.stat().st_size
    gone = prune(tmp_path, keep_bytes=2500 + size, keep_s=1e12)
    assert [path.name for path in gone] == ["gpdf_0.mcap", f"gpdf_1.mcap{BROKEN}", "gpdf_2.mcap"]
    gone = prune(tmp_path, keep_bytes=1e12, keep_s=time.time() - 1e9 - 3.5)
    assert [path.name for path in gone] == ["gpdf_3.mcap"]
    live.close()
    assert sorted(path.name for path in tmp_path.iterdir())[:2] == ["gpdf_4.mcap", live.path.name]
    assert (tmp_path / "mine.mcap").exists()


def test_a_clock_that_jumps_does_not_empty_the_log(tmp_path):
    for i in range(10):
        path = tmp_path / f"gpdf_{i}.mcap"
        path.write_bytes(bytes(1000))
        os.utime(path, (i, i))  # 1970, as on a machine without a battery
    day = 86_400.0
    gone = prune(tmp_path, keep_bytes=1e12, keep_s=90 * day, spare_s=day)
    assert [path.name for path in gone] == ["gpdf_0.mcap", "gpdf_1.mcap"]
    gone = prune(tmp_path, keep_bytes=4500, keep_s=90 * day, spare_s=day)
    assert len(gone) == 6  # four for their size, two for their age


def test_a_hundred_scenes_are_a_small_head_of_each_file(tmp_path):
    recorder = Recorder(Options(log_dir=tmp_path, log_segment_mb=1.0, log_sync="each"), "x", {})
    points = np.random.default_rng(0).uniform(size=(100_000, 3))
    for i in range(100):
        recorder.scene(f"s{i}", points, {"version": i})
    for i in range(5):
        recorder.exchange("k", b"", b"x", i, i)
    recorder.close()
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) <= 50  # the head alone fills none: it would be written again with each message
    for path in files[1:]:
        assert path.stat().st_size < 20e6
    names = {record.name for record in make_reader(files[-1].open("rb")).iter_metadata()}
    assert names >= {f"scene/s{i}" for i in range(100)}


def test_a_disk_short_of_room_is_told_and_recording_begins_again(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("gpdf_service.service.recorder.RETRY_S", 0.0)
    recorder = Recorder(Options(log_dir=tmp_path, log_sync="each"), "x", {})
    recorder.exchange("k", b"", b"before", 0, 0)
    recorder.options = Options(log_dir=tmp_path, log_sync="each", log_min_free_mb=1e12)
    for _ in range(4):
        recorder.exchange("k", b"", b"lost", 0, 0)
    assert "log-min-free-mb" in recorder.trouble
    assert recorder.lost >= 3  # the first one finds it out, after it was written
    recorder.options = Options(log_dir=tmp_path, log_sync="each")
    recorder.exchange("k", b"", b"after", 0, 0)
    assert recorder.trouble == ""
    recorder.close()
    found = messages(tmp_path)
    assert found[1] == b"before"
    assert found[-1] == b"after"
    assert found.count(b"lost") == 4 - recorder.lost
    assert "NOT RECORDING" in caplog.text
    assert "recording again" in caplog.text
    assert all(check(path).complete for path in tmp_path.glob("*.mcap"))


def limited(log_dir, state_dir, clouds, endpoint, limit):
    """`gpdf serve` whose files may not grow beyond `limit` bytes: each write beyond it fails as on a full disk."""
    words = [sys.executable, "-m", "gpdf_service.cli", "serve", "--endpoint", endpoint, "--scenes-dir", str(clouds)]
    words += ["--workers", "1", "--log-dir", str(log_dir), "--state-dir", str(state_dir), "--log-min-free-mb", "0.001"]
    return subprocess.Popen(
        words,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )


def with_office(log_dir, state_dir, clouds, endpoint):
    """The scene is in the state folder, before the disk is full."""
    with Server(Options(endpoint, clouds, log_dir, 1, state_dir=state_dir)), Client.connect(endpoint) as client:
        client.load_scene("office", "office.gpdf")
    for path in log_dir.glob("*.mcap"):
        path.unlink()


def plan_many(endpoint, made, count):
    with Client.connect(endpoint, timeout_s=60) as client:
        client.wait_for_scene("office")
        return [client.plan("office", made.start, made.goal, "roomba").status for _ in range(count)]


@pytest.mark.slow
def test_files_that_cannot_grow_do_not_stop_planning(tmp_path, free_endpoint, office, office_file):
    shutil.copy(office_file, tmp_path / "office.gpdf")
    with_office(tmp_path / "log", tmp_path / "state", tmp_path, free_endpoint)
    with limited(tmp_path / "log", tmp_path / "state", tmp_path, free_endpoint, 30_000) as process:
        try:
            assert plan_many(free_endpoint, office[0], 30) == ["OK"] * 30
        finally:
            process.terminate()
            words = process.communicate(timeout=60)[1]
    assert process.returncode == 0
    assert "NOT RECORDING" in words
    assert repair_folder(tmp_path / "log")


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a disk")
def test_a_full_disk_does_not_stop_planning_and_leaves_readable_logs(tmp_path, free_endpoint, office, office_file):
    shutil.copy(office_file, tmp_path / "office.gpdf")
    log_dir = tmp_path / "log"
    log_dir.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(log_dir)]).returncode:
        pytest.skip("no disk can be mounted here")
    try:
        with_office(tmp_path / "elsewhere", tmp_path / "state", tmp_path, free_endpoint)
        with limited(log_dir, tmp_path / "state", tmp_path, free_endpoint, resource.RLIM_INFINITY) as process:
            try:
                assert plan_many(free_endpoint, office[0], 3) == ["OK"] * 3
                until = time.monotonic() + 300
                while sum(len(list(recorded_plans(path))) for path in log_dir.glob("*.mcap")) < 3:
                    assert time.monotonic() < until
                    time.sleep(0.05)  # they are written with the next chunk
                with Client.connect(free_endpoint) as client:
                    for _ in range(3):  # 5 MB each with its answer
                        client.distance("office", "ground", np.random.default_rng(0).uniform(0, 5, (90_000, 3)))
                assert plan_many(free_endpoint, office[0], 20) == ["OK"] * 20
            finally:
                process.terminate()
                words = process.communicate(timeout=60)[1]
        assert process.returncode == 0
        assert "NOT RECORDING" in words
        logs = list(log_dir.glob("*.mcap"))
        assert sum(check(path).messages for path in logs) > 0
    finally:
        subprocess.run(["umount", str(log_dir)], check=True)


def test_what_a_crash_left_is_kept_beside_the_mended_log(tmp_path):
    recorder = Recorder(Options(log_dir=tmp_path), "x", {})
    for i in range(5):
        recorder.exchange(keys.PLAN, b"", BLOB, i, i)
    recorder.close()
    path = recorder.path
    broken = path.read_bytes()[:-500]
    for name in (BROKEN, f"{BROKEN}1"):
        path.write_bytes(broken)
        assert repair(path).complete
        assert path.with_name(path.name + name).read_bytes() == broken
    assert not list(tmp_path.glob("*.repairing"))


def test_a_folder_of_logs_is_checked_and_mended_but_none_that_a_service_writes(tmp_path, capsys):
    live = Recorder(Options(log_dir=tmp_path, log_sync="each"), "live", {})
    live.exchange("k", b"", b"1", 0, 0)
    cut = tmp_path / "gpdf_0.mcap"
    cut.write_bytes(live.path.read_bytes())
    before = live.path.read_bytes()
    assert main(["record", "check", str(tmp_path)]) == 1
    assert "being written" in capsys.readouterr().out
    assert main(["record", "check", "--repair", "--json", str(tmp_path)]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(row["complete"], row["live"]) for row in rows] == [(True, False), (False, True)]
    assert live.path.read_bytes() == before
    live.close()
    assert check(live.path).complete
    (tmp_path / "none").mkdir()
    assert main(["record", "check", str(tmp_path), str(tmp_path / "none")]) == 1


@pytest.mark.slow
def test_a_plan_is_in_the_log_when_the_process_is_killed_after_its_answer(tmp_path, free_endpoint, office, office_file):
    shutil.copy(office_file, tmp_path / "office.gpdf")
    words = [sys.executable, "-m", "gpdf_service.cli", "serve", f"office={tmp_path / 'office.gpdf'}", "--log-sync"]
    words += ["each", "--endpoint", free_endpoint, "--log-dir", str(tmp_path / "log")]
    with subprocess.Popen(words, stderr=subprocess.DEVNULL) as process:
        try:
            plan_many(free_endpoint, office[0], 3)
        finally:
            process.kill()
    (log,) = (tmp_path / "log").glob("*.mcap")
    assert len(list(recorded_plans(log))) == 3


@pytest.mark.parametrize("body", [b"", BLOB])
def test_who_must_not_wait_for_a_log_that_is_behind_goes_on_and_the_loss_is_counted(tmp_path, monkeypatch, body):
    """What waits is bounded by its bytes: two messages, whether they are small or large."""
    monkeypatch.setattr("gpdf_service.service.recorder.TASK_BYTES", 100)
    monkeypatch.setattr("gpdf_service.service.recorder.QUEUE_BYTES", 2 * (100 + len(body)))
    gate, inside = threading.Event(), threading.Event()
    write = Segment.write

    def slow(*args, **more):
        inside.set()
        gate.wait(30)
        write(*args, **more)

    monkeypatch.setattr(Segment, "write", slow)
    recorder = Recorder(Options(log_dir=tmp_path, log_sync="each"), "x", {})
    recorder.exchange("k", b"", b"0" + body, 0, 0, patient=False)
    assert inside.wait(30)  # the writer is held by the first; two more fit
    for i in range(1, 6):
        recorder.exchange("k", b"", bytes([48 + i]) + body, 0, 0, patient=False)
    recorder.publication("p", b"", 0)
    assert recorder.lost == 4
    gate.set()
    recorder.close()
    assert messages(tmp_path) == [data for digit in (b"0", b"1", b"2") for data in (b"", digit + body)]


def flipped(path, text):
    """The log with some bytes of a chunk that holds `text` turned round, and where the chunk is."""
    with path.open("rb") as file:
        places = [index.chunk_start_offset for index in make_reader(file).get_summary().chunk_indexes]
    data = bytearray(path.read_bytes())
    place = next(at for at in places if text in data[at : at + 30_000])
    at = data.index(text, place)
    data[at : at + 20] = bytes(255 - byte for byte in data[at : at + 20])
    path.write_bytes(data)


def three_chunks(folder):
    """A log whose messages do not compress, so that a flipped byte is a flipped byte."""
    recorder = Recorder(Options(log_dir=folder, log_sync="each"), "x", {"planner": "p"})
    for i in range(3):
        recorder.exchange("k", b"", bytes([i]) + BLOB, i, i)
    recorder.close()
    return recorder.path


def test_a_log_that_is_not_as_it_was_written_says_so_and_is_mended_without_what_cannot_be_trusted(tmp_path, capsys):
    path = three_chunks(tmp_path)
    assert check(path).whole
    whole = messages(tmp_path)
    flipped(path, b"\x01" + BLOB[:30])
    found = check(path)
    assert (found.complete, found.whole) == (True, False)
    assert [("messages from" in words, "crc" in words) for words in found.damage] == [(True, True), (False, True)]
    assert main(["record", "check", str(path)]) == 1
    assert "DAMAGED" in capsys.readouterr().out
    assert repair_folder(tmp_path) == []  # what was done to it is evidence until somebody says otherwise
    assert main(["record", "check", "--repair", str(path)]) == 0
    assert check(path).whole
    assert whole == [data for i in range(3) for data in (b"", bytes([i]) + BLOB)]
    assert messages(tmp_path) == whole[:2] + whole[4:]  # an exchange is a chunk: the request goes with its reply


def test_metadata_that_is_not_as_it_was_written_is_damage_too(tmp_path):
    path = three_chunks(tmp_path)
    data, text = path.read_bytes(), b"planner"
    at = data.index(text)
    path.write_bytes(data[:at] + text[::-1] + data[at + len(text) :])
    assert not check(path).whole


def test_messages_whose_channel_was_told_of_in_a_damaged_chunk_are_read_all_the_same(tmp_path):
    path = three_chunks(tmp_path)
    flipped(path, b"\x00" + BLOB[:30])
    repair(path)
    assert [data[0] for data in messages(tmp_path) if data[1:] == BLOB] == [1, 2]


def test_a_damaged_log_is_not_replayed_as_if_it_were_whole(tmp_path, free_endpoint, office, office_file, capsys):
    shutil.copy(office_file, tmp_path / "office.gpdf")
    with (
        Server(Options(free_endpoint, tmp_path, tmp_path / "log", 1)) as server,
        Client.connect(free_endpoint) as client,
    ):
        client.load_scene("office", "office.gpdf")
        for name in ("one", "two"):
            client.plan("office", office[0].start, office[0].goal, "roomba", request_id=name)
            client.distance("office", "ground", np.random.default_rng(0).uniform(0, 5, (90_000, 3)))  # a chunk each
    path = server.recorder.path
    log = bytearray(path.read_bytes())
    with path.open("rb") as file:
        first = min(make_reader(file).get_summary().chunk_indexes, key=lambda index: index.chunk_start_offset)
    at = first.chunk_start_offset + first.chunk_length // 2
    log[at : at + 20] = bytes(255 - byte for byte in log[at : at + 20])
    path.write_bytes(log)
    assert main(["replay", str(path), "--scene", f"office={tmp_path / 'office.gpdf'}"]) == 1
    assert "DAMAGED" in capsys.readouterr().err


def test_who_fills_the_log_deletes_nothing_that_is_young_and_exchanges_go_on_as_hashes(tmp_path):
    options = Options(log_dir=tmp_path, log_segment_mb=0.05, log_keep_mb=0.1, log_sync="each")
    recorder = Recorder(options, "x", {})
    recorder.exchange("k", b"", b"evidence", 0, 0)
    for i in range(20):
        recorder.exchange("k", b"", bytes([i]) + BLOB, i, i)
    assert recorder.evidence.thrifty
    topic, request, reply = recorder.evidence.of("me", keys.PLAN, Status.OK, BLOB, BLOB)
    assert (topic, len(request) < 200, len(reply) < 200) == (f"{keys.PLAN}/digest", True, True)
    recorder.close()
    assert b"evidence" in messages(tmp_path)
    assert prune(tmp_path, keep_bytes=0, keep_s=1e9, spare_s=3600.0) == []
