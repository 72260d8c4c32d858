import re
from pathlib import Path

import gpdf_schemas
import msgspec
import numpy as np
import pytest
from gpdf_schemas import (
    Array,
    Ask,
    AskMessage,
    CueAction,
    CueMessage,
    Cylinder,
    DecodeError,
    MovingObstacles,
    PlanReply,
    PlanRequest,
    PoseMessage,
    SayMessage,
    Status,
    VelocityMessage,
    decode,
    encode,
)
from gpdf_schemas.generate import MESSAGES, schema_of

import gpdf_service as gpdf

FOLDER = Path(__file__).parent.parent.parent / "schemas"


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
def test_the_json_schemas_are_fresh(kind):
    assert (FOLDER / "json" / f"{kind.__name__}.json").read_text() == schema_of(kind), "run: make schemas"


WORDS = (FOLDER / "CONVENTIONS.md").read_text()
COMMON = {"request_id", "deadline_s"} | {field.name for field in msgspec.structs.fields(gpdf_schemas.Reply)}


NAMED = re.findall(r"^\| ([A-Z]\w+[a-z]) \| .*`", WORDS, re.MULTILINE)


@pytest.mark.parametrize("name", NAMED)
def test_the_fields_of_each_message_are_in_the_conventions(name):
    needed, _, others = re.search(rf"^\| {name} \| (.*) \|$", WORDS, re.MULTILINE)[1].partition(";")
    fields = msgspec.structs.fields(getattr(gpdf_schemas.messages, name))
    hidden = COMMON if name.endswith(("Request", "Reply")) else set()
    hidden = hidden - {"scene"} if name.endswith("Request") else hidden
    asked = {field.name for field in fields if field.required} - hidden
    assert set(re.findall(r"`(\w+)`", needed)) == asked
    assert {field.name for field in fields} - asked - hidden <= set(re.findall(r"`(\w+)`", others))


def test_every_message_and_status_is_in_the_conventions():
    assert {kind.__name__ for kind in MESSAGES} - set(NAMED) == {
        "AskMessage",
        "SayMessage",
    }  # they have a paragraph each
    assert set(Status) <= set(re.findall(r"\b[A-Z_]+\b", WORDS.partition("| status | what to do |")[2]))


def test_every_status_of_the_planner_is_on_the_wire():
    for status in gpdf.Status:
        assert Status(status.value) == status


def test_an_array_comes_back_equal():
    values = np.random.default_rng(0).normal(size=(7, 3))
    np.testing.assert_array_equal(Array.pack(values).unpack(), values)
    np.testing.assert_allclose(Array.pack(values, "f4").unpack(), values, atol=1e-6)


@pytest.mark.parametrize(
    "array",
    [
        Array((2, 3), "f8", b"short"),
        Array((2,), "i8", b"0" * 16),
        Array((-1, -2), "f8", b"0" * 16),
        Array((1, 1, 2), "f8", b"0" * 16),
        Array((2,), "f8", np.array([1.0, np.nan]).tobytes()),
        Array((1 << 62, 4), "f8", b"0" * 32),
    ],
)
def test_an_array_that_does_not_fit_is_refused(array):
    with pytest.raises(ValueError, match=r"fill|dtype|shape|finite"):
        array.unpack()


def test_unknown_fields_are_ignored_and_missing_ones_refused():
    raw = msgspec.msgpack.encode({"scene": "a", "start": [1.0, 2.0], "goal": [1.0, 2.0], "later": 5})
    assert decode(raw, PlanRequest).scene == "a"
    with pytest.raises(DecodeError, match="goal"):
        decode(msgspec.msgpack.encode({"scene": "a", "start": [1.0, 2.0]}), PlanRequest)


@pytest.mark.parametrize("cut", [0, 1, 10, -1])
def test_truncated_bytes_are_refused(cut):
    raw = encode(PlanRequest(scene="a", start=[1.0, 2.0], goal=[1.0, 2.0]))
    with pytest.raises(DecodeError):
        decode(raw[:cut], PlanRequest)


def test_too_long_a_request_is_refused_before_it_is_decoded():
    with pytest.raises(DecodeError, match="at most 10"):
        decode(b"\x80" * 11, PlanRequest, limit=10)


def test_golden_samples_of_version_one_are_still_read():
    request = decode((FOLDER / "golden" / "v1_plan_request.msgpack").read_bytes(), PlanRequest)
    assert (request.scene, request.start, request.agent) == ("office", [1.0, 2.0], "human")
    reply = decode((FOLDER / "golden" / "v1_plan_reply.msgpack").read_bytes(), PlanReply)
    assert reply.status is Status.OK
    assert reply.trajectory.positions.unpack().tolist() == [[0.0, 0.0, 2.0], [1.0, 0.0, 2.0]]
    assert reply.certificate.min_clearance == 0.25
    assert reply.certificate.ground_spacing == 0.0  # nothing was told of it then


def test_the_golden_sample_of_a_request_with_options_is_still_read():
    request = decode((FOLDER / "golden" / "v1_plan_request_options.msgpack").read_bytes(), PlanRequest)
    assert (request.via, request.other_goals, request.snap) == ([[2.0, 2.0]], [[5.0, 1.0, 0.0]], 0.5)
    assert request.warm_start.unpack().tolist() == [[1.0, 2.0, 0.0], [4.0, 2.0, 0.0]]
    old = decode((FOLDER / "golden" / "v1_plan_request.msgpack").read_bytes(), PlanRequest)
    assert (old.via, old.other_goals, old.snap, old.warm_start) == ([], [], 0.0, None)


def test_golden_samples_of_what_one_prefers_and_of_alternatives_are_still_read():
    request = decode((FOLDER / "golden" / "v1_plan_request_prefer.msgpack").read_bytes(), PlanRequest)
    assert (request.prefer, request.alternatives) == ("level", 2)
    old = decode((FOLDER / "golden" / "v1_plan_request.msgpack").read_bytes(), PlanRequest)
    assert (old.prefer, old.alternatives) == ("", 0)
    (other,) = decode((FOLDER / "golden" / "v1_plan_reply_alternatives.msgpack").read_bytes(), PlanReply).alternatives
    assert other.trajectory.ground.unpack().tolist() == [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    assert (other.certificate.max_step, other.details) == (0.1, {"cost": 3.5, "steps": 1.0})
    assert decode((FOLDER / "golden" / "v1_plan_reply.msgpack").read_bytes(), PlanReply).alternatives == []


def test_golden_samples_of_the_streams_are_still_read():
    pose = decode((FOLDER / "golden" / "v1_pose.msgpack").read_bytes(), PoseMessage)
    assert pose == PoseMessage(position=[1.0, 2.0, 0.5], heading=1.5, stamp=1700000000.25, accuracy=0.05)
    cue = decode((FOLDER / "golden" / "v1_cue.msgpack").read_bytes(), CueMessage)
    assert cue.action is CueAction.TURN
    assert (cue.direction, cue.urgency, cue.pace, cue.distance) == (-1.25, 0.5, 0.75, 4.0)
    assert (cue.stamp, cue.pose_stamp) == (1700000000.5, 1700000000.25)
    (seen,) = decode((FOLDER / "golden" / "v1_moving_obstacles.msgpack").read_bytes(), MovingObstacles).obstacles
    assert seen.points.unpack().tolist() == [[1.0, 2.0, 0.5]]
    assert (seen.id, seen.cylinder.base, seen.cylinder.height, seen.lifetime_s) == ("dog", (1.0, 2.0, 0.0), 0.5, 1.5)


def test_the_golden_samples_of_what_is_said_and_asked_are_still_read():
    said = decode((FOLDER / "golden" / "v1_say.msgpack").read_bytes(), SayMessage)
    assert (said.id, said.text, said.language) == ("anna-7", "In 2 metres, stairs up, 16 steps.", "en")
    assert (said.kind, said.urgency, said.about) == ("stairs", 2, [4.5, 1.0, 0.25])
    assert (said.stamp, said.valid_until, said.reply_to) == (1700000000.25, 1700000002.25, "b3")
    assert said.answers == [Ask.YES, Ask.NO]
    asked = decode((FOLDER / "golden" / "v1_ask.msgpack").read_bytes(), AskMessage)
    assert asked == AskMessage(ask=Ask.GOAL, id="b3", goal="kitchen", stamp=1700000000.5)
    assert decode(encode(AskMessage(ask=Ask.GOAL, goal=[1.0, 2.0, 0.5])), AskMessage).goal == [1.0, 2.0, 0.5]


def test_a_pose_may_count_steps_and_an_old_one_counts_none():
    assert decode((FOLDER / "golden" / "v1_pose.msgpack").read_bytes(), PoseMessage).steps is None
    counted = PoseMessage(position=[0.0, 0.0, 0.0], heading=0.0, stamp=1.0, steps=12)
    assert decode(encode(counted), PoseMessage).steps == 12


def test_the_golden_sample_of_a_velocity_is_still_read():
    velocity = decode((FOLDER / "golden" / "v1_velocity.msgpack").read_bytes(), VelocityMessage)
    assert velocity == VelocityMessage(forward=0.25, left=-0.5, turn=1.5, stamp=1700000000.25, state="driving")
    assert velocity.valid_s == 0.5


def test_a_number_that_is_not_finite_is_no_pose():
    raw = encode(PoseMessage(position=[1.0, float("nan"), 0.0], heading=0.0, stamp=0.0))
    with pytest.raises(DecodeError, match="finite"):
        decode(raw, PoseMessage)


def test_numpys_numbers_are_numbers_and_other_things_are_refused():
    numbers = Cylinder(tuple(np.array([1.0, 2.0, 0.0])), np.float64(0.25), np.float32(0.5))
    assert encode(numbers) == encode(Cylinder((1.0, 2.0, 0.0), 0.25, 0.5))
    with pytest.raises(NotImplementedError, match="object"):
        encode(Cylinder((1.0, 2.0, 0.0), object(), 0.5))
