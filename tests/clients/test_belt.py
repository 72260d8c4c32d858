"""A belt lets one feel the cues: pybelt itself speaks its protocol over a serial line to a belt that is made up here.

No real belt was tried: the other end of the line answers as pybelt expects a naviBelt to.
"""

import os
import signal
import subprocess
import sys
import termios
import threading
import time
import tty
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zenoh
from gpdf_guidance.belt import (
    AGAIN,
    ALL_MOTORS,
    CONTINUOUS,
    DOUBLE_LONG,
    DOUBLE_SHORT,
    LASTS,
    SILENCE,
    Belt,
    BeltError,
    buzz,
    connect,
)
from gpdf_schemas import CueAction, CueMessage, encode, keys

from gpdf_service.ports import free_endpoint
from gpdf_service.service.server import Options, Server

VIBRATE, REQUEST, NOTIFY, FIRMWARE = 36, 41, 43, 31
"""Handles of the belt's values on a serial line."""
ANSWERS = {
    b"\x01\x01": b"\x01\x01\x01",  # the mode: it waits
    b"\x01\x02": b"\x01\x02\x32",  # intensity, 50 %
    b"\x01\x03": b"\x01\x03\x00\x00",  # where its front is
    b"\x10\x01\x03": b"\x10\x03\x00",  # what it does when its compass is not sure
}


def cue(action, direction=0.0, stamp=0.0):
    return CueMessage(
        action=action, direction=direction, urgency=0.0, pace=0.7, distance=5.0, stamp=stamp, pose_stamp=stamp
    )


class MadeUpBelt:
    """The other end of a serial line: answers what pybelt asks, and keeps each vibration and when it was told."""

    def __init__(self):
        self._line, slave = os.openpty()
        tty.setraw(slave)
        self.port, self.felt, self.mode, self.acknowledges = os.ttyname(slave), [], None, True
        self._slave = slave
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        waiting = b""
        while True:
            try:
                waiting += os.read(self._line, 256)
            except OSError:
                return
            while len(waiting) >= 2 and len(waiting) >= 2 + waiting[1]:
                handle, data = waiting[0], waiting[2 : 2 + waiting[1]]
                waiting = waiting[2 + waiting[1] :]
                self._take(handle, data)

    def _take(self, handle, data):
        if handle == VIBRATE:
            self.felt.append((time.time(), data))
        elif handle == FIRMWARE:
            self._say(FIRMWARE, b"\x37\x00")
        elif handle == REQUEST and data[:2] == b"\x01\x81":
            self.mode = data[2]
            if self.acknowledges:
                self._say(NOTIFY, b"\x01\x01" + data[2:])
        elif handle == REQUEST:
            self._say(NOTIFY, ANSWERS[data])

    def jam(self):
        """The line takes nothing more, and is not gone: a cable that hangs, a belt that has stopped."""
        termios.tcflow(self._slave, termios.TCOOFF)

    def _say(self, handle, data):
        os.write(self._line, bytes([handle, len(data)]) + data)

    def gone(self):
        os.close(self._line)
        os.close(self._slave)


@pytest.fixture
def made_up():
    pytest.importorskip("pybelt")
    return MadeUpBelt()


class Line:
    """Keeps what a belt is told."""

    def __init__(self, takes=True):
        self.told, self.takes = [], takes

    def send_vibration_command(self, **command):
        self.told.append(command)
        return self.takes


def test_a_direction_is_felt_where_it_is_and_stop_all_around():
    assert buzz(cue(CueAction.GO)).motor == 0
    assert buzz(cue(CueAction.GO, np.pi / 2)).motor == 12  # to the left: clockwise, three quarters
    assert buzz(cue(CueAction.TURN, -np.pi / 2)) == buzz(cue(CueAction.TURN, 1.5 * np.pi))
    assert buzz(cue(CueAction.TURN, -np.pi / 2)).motor == 4
    assert buzz(cue(CueAction.STOP)).motor is buzz(cue(CueAction.ARRIVED)).motor is None
    assert len({buzz(cue(action)) for action in CueAction}) == len(CueAction)  # none feels like another


def test_what_is_true_is_told_again_before_it_ends_and_what_is_not_new_is_not():
    line = Line()
    belt = Belt(line)
    for now in np.arange(0.0, 3.0, 0.1):
        belt.step(cue(CueAction.GO, stamp=now), now)
    assert 3.0 / LASTS < len(line.told) <= 3.0 / AGAIN + 1
    assert all(told["pattern_iterations"] == 1 for told in line.told)  # each ends by itself
    assert all(told["pattern_period"] == 1000 * LASTS for told in line.told)
    count = len(line.told)
    for now in np.arange(3.0, 6.0, 0.1):
        belt.step(cue(CueAction.STOP, stamp=now), now)
    assert [told["pattern"] for told in line.told[count:]] == [DOUBLE_LONG]


def test_without_cues_and_with_late_ones_it_says_stop_within_half_a_second():
    line = Line()
    belt = Belt(line)
    belt.step(None, 0.0)
    assert line.told == []  # nobody is led yet
    belt.step(cue(CueAction.GO, stamp=1.0), 1.0)
    belt.step(None, 1.0 + SILENCE - 0.01)
    assert [told["pattern"] for told in line.told] == [CONTINUOUS]
    belt.step(cue(CueAction.GO, stamp=1.0), 1.0 + SILENCE + 0.01)  # what a bad network brings
    assert [told["pattern"] for told in line.told] == [CONTINUOUS, DOUBLE_LONG]
    belt.step(cue(CueAction.GO, stamp=2.0), 2.0)
    assert line.told[-1]["pattern"] == CONTINUOUS


def test_a_belt_that_takes_nothing_is_none():
    with pytest.raises(BeltError, match="ttyUSB7"):
        Belt(Line(takes=False), "ttyUSB7").step(cue(CueAction.GO), 0.0)


@pytest.mark.slow
def test_pybelt_tells_the_belt_over_its_serial_line(made_up):
    controller = connect(made_up.port)
    try:
        assert made_up.mode == 3  # an app's
        belt = Belt(controller, made_up.port)
        belt.step(cue(CueAction.TURN, np.pi / 2), 0.0)
        belt.step(cue(CueAction.STOP), 0.1)
        until = time.time() + 5
        while len(made_up.felt) < 2 and time.time() < until:
            time.sleep(0.01)
        (_, turn), (_, stop) = made_up.felt
        assert (turn[1], turn[6], int.from_bytes(turn[7:9], "little")) == (DOUBLE_SHORT, 2, 270)
        assert (stop[1], stop[6], int.from_bytes(stop[7:9], "little")) == (DOUBLE_LONG, 0, ALL_MOTORS)
        assert turn[11] == stop[11] == 1  # once
        assert int.from_bytes(turn[12:14], "little") == 1000 * LASTS
    finally:
        controller.disconnect_belt()
        made_up.gone()


@contextmanager
def verb_at(port, address):
    """`gpdf belt` in a process of its own, which is killed at the end if it runs on."""
    command = [sys.executable, "-m", "gpdf_service.cli", "belt", port, "--name", "anna", "--endpoint", address]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as verb:
        try:
            yield verb
        finally:
            verb.kill()


def has_opened(port, process):
    """Whether the verb has the line open; between fork and exec a child has what the tests have open."""
    runs = b"gpdf_service.cli" in (process / "cmdline").read_bytes()
    return runs and port in {str(fd.readlink()) for fd in (process / "fd").iterdir() if fd.is_symlink()}


def cues_to(address):
    return zenoh.open(zenoh.Config.from_json5(f'{{mode: "client", connect: {{endpoints: ["{address}"]}}}}'))


@pytest.mark.slow
def test_the_verb_ends_by_itself_where_a_belt_does_not_take_its_mode(made_up):
    made_up.acknowledges = False
    with verb_at(made_up.port, free_endpoint()) as verb:
        assert verb.wait(30) == 1
        assert "no naviBelt answers" in verb.stderr.read()
    assert made_up.mode == 3
    made_up.gone()


@pytest.mark.slow
def test_the_verb_ends_on_a_signal_while_a_line_takes_nothing(made_up):
    made_up.jam()
    with verb_at(made_up.port, free_endpoint()) as verb:
        until = time.time() + 30
        while not has_opened(made_up.port, Path(f"/proc/{verb.pid}")):
            assert time.time() < until
            time.sleep(0.05)
        verb.send_signal(signal.SIGTERM)
        assert verb.wait(30) == -signal.SIGTERM
    made_up.gone()


@pytest.mark.slow
@pytest.mark.parametrize("what", ["jam", "gone"])
def test_a_line_that_takes_nothing_more_is_no_belt_and_the_guide_sees_it(made_up, tmp_path, what):
    with (
        Server(Options(free_endpoint(), tmp_path, tmp_path, 1)) as server,
        verb_at(made_up.port, server.options.endpoint) as verb,
        cues_to(server.options.endpoint) as session,
    ):
        assert "feels the cues of anna" in verb.stdout.readline()
        publisher = session.declare_publisher(f"{keys.CUE}/anna")
        for number in range(300):
            publisher.put(encode(cue(CueAction.GO, direction=number % 2, stamp=time.time())))
            if number == 10:
                assert publisher.matching_status.matching
                getattr(made_up, what)()
            if verb.poll() is not None:
                break
            time.sleep(0.1)
        assert verb.wait(0.1) == 1
        assert "no naviBelt answers" in verb.stderr.read()
        until = time.time() + 5
        while publisher.matching_status.matching and time.time() < until:
            time.sleep(0.05)
        assert not publisher.matching_status.matching  # nobody feels the cues: the guide speaks of every stop
    if what == "jam":
        made_up.gone()


@pytest.mark.slow
def test_the_verb_stops_the_person_when_the_guide_falls_silent(made_up, tmp_path):
    with (
        Server(Options(free_endpoint(), tmp_path, tmp_path, 1)) as server,
        verb_at(made_up.port, server.options.endpoint) as verb,
    ):
        assert "feels the cues of anna" in verb.stdout.readline()
        with cues_to(server.options.endpoint) as session:
            for _ in range(20):
                session.put(f"{keys.CUE}/anna", encode(cue(CueAction.GO, stamp=time.time())))
                last = time.time()
                time.sleep(0.1)
            time.sleep(1.0)
        patterns = [data[1] for _, data in made_up.felt]
        assert patterns[0] == CONTINUOUS
        assert patterns[-1] == DOUBLE_LONG
        stopped = next(when for when, data in made_up.felt if data[1] == DOUBLE_LONG and when > last)
        print(f"said stop {1000 * (stopped - last):.0f} ms after the last cue")
        assert stopped - last < SILENCE + 2.0  # by the clock of a loaded machine
        verb.send_signal(signal.SIGTERM)
        assert verb.wait(30) == 0
    made_up.gone()
