"""Who is on the way: what is kept of what was heard."""

import numpy as np
import pytest
from gpdf_schemas import CueAction, CueMessage, PoseMessage, VelocityMessage, encode, keys

from gpdf_service.viewer.live import OLD_S, Heard

ANNA, SPOT = f"{keys.POSE}/anna", f"{keys.POSE}/spot"


class Clock:
    now = 1000.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def heard(clock):
    return Heard(clock)


def pose(stamp, x=1.0):
    return encode(PoseMessage(position=[x, 2.0, 0.0], heading=0.5, stamp=stamp))


def test_the_newest_pose_of_each_body_is_shown_and_an_old_one_no_more(heard, clock):
    heard.take(ANNA, pose(1000.0))
    heard.take(ANNA, pose(999.5, x=9.0))  # overtaken on the way
    heard.take(SPOT, pose(999.0))
    now = heard.now()
    assert now["anna"][0].position[0] == 1.0
    assert now.keys() == {"anna", "spot"}
    clock.now = 999.5 + OLD_S
    assert heard.now().keys() == {"anna"}
    clock.now = 1001.0 + OLD_S
    assert heard.now() == {}


@pytest.mark.parametrize("stamp", [1000.0 - OLD_S - 0.1, 1000.0 + OLD_S + 0.1])
def test_a_pose_of_another_time_is_none(heard, stamp):
    heard.take(ANNA, pose(stamp))
    assert heard.now() == {}


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\xc1",
        encode(PoseMessage(position=[1.0, 2.0], heading=0.0, stamp=1000.0)),
        encode(PoseMessage(position=[1.0, np.nan, 0.0], heading=0.0, stamp=1000.0)),
    ],
)
def test_what_is_no_pose_is_not_shown(heard, payload):
    heard.take(ANNA, payload)
    assert heard.now() == {}


@pytest.mark.parametrize(
    ("key", "message", "order"),
    [
        (
            keys.CUE,
            CueMessage(action=CueAction.GO, direction=0.5, urgency=0.0, distance=4.2, stamp=1000.0),
            "go 29° left, 4.2 m to go",
        ),
        (
            keys.CUE,
            CueMessage(action=CueAction.TURN, direction=-1.0, urgency=0.0, distance=4.2, stamp=1000.0),
            "turn 57° right, 4.2 m to go",
        ),
        (keys.CUE, CueMessage(action=CueAction.STOP, direction=0.5, urgency=1.0, stamp=1000.0), "stop"),
        (
            keys.VELOCITY,
            VelocityMessage(forward=0.6, left=0.0, turn=0.1, stamp=1000.0, state="driving"),
            "driving 0.6 m/s",
        ),
        (
            keys.CUE,
            CueMessage(action=CueAction.GO, direction=0.0, urgency=0.0, stamp=900.0),
            "",
        ),  # an old order is none
    ],
)
def test_what_a_body_is_told_stands_beside_its_name(heard, key, message, order):
    heard.take(ANNA, pose(1000.0))
    heard.take(f"{key}/anna", encode(message))
    assert heard.now()["anna"][1] == order


def test_an_order_without_a_pose_is_nobody(heard):
    heard.take(f"{keys.CUE}/anna", encode(CueMessage(action=CueAction.GO, direction=0.0, urgency=0.0, stamp=1000.0)))
    assert heard.now() == {}
