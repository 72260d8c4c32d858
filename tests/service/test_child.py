"""Children are forked of one process that has loaded what they run: what becomes of them, and of it."""

import contextlib
import os
import resource
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import psutil
import pytest

from gpdf_service.service.child import NURSERY, START_S, Child
from gpdf_service.service.pool import PROGRAM, READY, Settings

SETTINGS = Settings(planner="me", memory_bytes=1e9, log_format="text")
PATIENCE_S = 300
"""[s] For what must happen at all."""


@contextlib.contextmanager
def begun(settings=SETTINGS):
    child = Child(PROGRAM, settings)
    try:
        yield child
    finally:
        child.kill()
        child.wait()


def wait_for(true):
    until = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < until
        time.sleep(0.01)


def worked(pid):
    return sum(psutil.Process(pid).cpu_times()[:2])


@pytest.fixture
def ready():
    """One that is there to be asked."""
    with begun() as child:
        assert child.hear(START_S) == READY
        yield child


def test_another_one_begins_for_a_twentieth_of_what_its_nursery_took(ready):
    with begun() as other:
        assert other.hear(START_S) == READY
        assert 20 * worked(other.pid) < worked(NURSERY.pid)


def test_one_that_is_killed_by_somebody_else_says_by_what(ready):
    os.kill(ready.pid, signal.SIGTERM)  # that is for the service
    os.kill(ready.pid, signal.SIGKILL)
    assert (ready.wait(), ready.wait()) == (-signal.SIGKILL, -signal.SIGKILL)
    with pytest.raises(EOFError):
        ready.hear(START_S)


def test_one_that_stands_still_can_be_ended(ready):
    os.kill(ready.pid, signal.SIGSTOP)
    ready.kill()
    assert ready.wait() == -signal.SIGKILL
    assert not psutil.pid_exists(ready.pid)


def test_one_that_nobody_holds_any_more_ends():
    child = Child(PROGRAM, SETTINGS)
    assert child.hear(START_S) == READY
    pid = child.pid
    del child
    wait_for(lambda: not psutil.pid_exists(pid))


def test_one_that_raises_says_where_and_ends_with_code_1(capfd):
    with begun(msgspec.defstruct("Other", ["words"])("no settings")) as child:
        assert child.wait() == 1
    assert "missing required field `planner`" in capfd.readouterr().err


def test_it_works_where_we_work_now_under_its_own_name_in_a_group_of_its_own(tmp_path, monkeypatch):
    for folder in (tmp_path / "one", tmp_path / "other"):
        folder.mkdir()
        monkeypatch.chdir(folder)
        with begun() as child:
            assert child.hear(START_S) == READY
            assert psutil.Process(child.pid).cwd() == str(folder)
            assert psutil.Process(child.pid).name() == "plan_process"
            assert os.getpgid(child.pid) == child.pid


def test_it_holds_nothing_of_the_children_beside_it(ready):
    with begun() as other:
        assert other.hear(START_S) == READY
        assert psutil.Process(other.pid).num_fds() == psutil.Process(ready.pid).num_fds()


def test_a_nursery_that_dies_takes_its_children_with_it_and_the_next_child_has_another_one(ready, caplog):
    before, pid = NURSERY.pid, ready.pid
    os.kill(before, signal.SIGKILL)
    assert ready.wait() == -signal.SIGKILL
    wait_for(lambda: not psutil.pid_exists(pid))
    with begun() as child:
        assert child.hear(START_S) == READY
        assert NURSERY.pid != before
    assert "has ended with code -9" in caplog.text


def test_a_nursery_is_ended_whatever_it_does_and_the_next_child_has_another_one():
    with begun() as child:
        assert child.hear(START_S) == READY
    before = NURSERY.pid
    os.kill(before, signal.SIGSTOP)
    NURSERY.end()
    NURSERY.end()
    assert not psutil.pid_exists(before)
    with begun() as child:
        assert child.hear(START_S) == READY


def test_of_one_that_dies_as_it_is_ended_no_more_is_heard_and_the_others_are_looked_after(ready):
    with begun() as other:
        assert other.hear(START_S) == READY
        os.kill(NURSERY.pid, signal.SIGSTOP)  # it hears of both at once
        try:
            wait_for(lambda: psutil.Process(NURSERY.pid).status() == psutil.STATUS_STOPPED)
            os.kill(other.pid, signal.SIGKILL)
            other.kill()
            wait_for(lambda: psutil.Process(other.pid).status() == psutil.STATUS_ZOMBIE)
        finally:
            os.kill(NURSERY.pid, signal.SIGCONT)
        assert other.wait() == -signal.SIGKILL
        ready.kill()
        wait_for(lambda: not psutil.pid_exists(ready.pid))


def test_one_that_hangs_as_it_begins_is_told_and_never_lives(ready):
    os.kill(NURSERY.pid, signal.SIGSTOP)
    try:
        child = Child(PROGRAM, SETTINGS)
        assert child.pid is None
        with pytest.raises(TimeoutError, match="hangs"):
            child.hear(0.2)
        child.kill()
        assert child.wait() == -signal.SIGKILL  # its nursery may be at it for minutes
        with pytest.raises(EOFError):
            child.hear(START_S)
    finally:
        os.kill(NURSERY.pid, signal.SIGCONT)
    assert ready.pid is not None
    wait_for(lambda: [one.pid for one in psutil.Process(NURSERY.pid).children()] == [ready.pid])


def test_who_waits_for_one_that_is_ended_before_it_is_born_is_told(ready):
    os.kill(NURSERY.pid, signal.SIGSTOP)
    try:
        child = Child(PROGRAM, SETTINGS)
        with ThreadPoolExecutor(1) as pool:
            heard = pool.submit(child.hear, PATIENCE_S)
            wait_for(heard.running)
            child.kill()
            assert isinstance(heard.exception(START_S), EOFError)
    finally:
        os.kill(NURSERY.pid, signal.SIGCONT)


def test_a_service_may_have_more_files_open_than_select_takes():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = 1024  # FD_SETSIZE
    if hard < 2 * most:
        pytest.skip("the system does not allow so many")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2 * most), hard))
    with contextlib.ExitStack() as held:
        held.callback(resource.setrlimit, resource.RLIMIT_NOFILE, (soft, hard))
        for _ in range(most):
            held.enter_context(Path(os.devnull).open())
        with begun() as child:
            assert child.hear(START_S) == READY
            assert child.pid is not None
