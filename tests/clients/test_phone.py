"""The guide in a phone's browser: alignment, token, certificate; a walk in a Chromium whose WebXR is emulated."""

import json
import math
import ssl
import urllib.request

import pytest
from gpdf_guidance.advice import UNRELIABLE
from gpdf_guidance.alignment import AHEAD, DRIFT, Clock, Tracked, align, to_pose, walk_on
from gpdf_schemas import AskMessage, PoseMessage, decode, keys

pytest.importorskip("websockets")
pytest.importorskip("cryptography")
phone_module = pytest.importorskip("gpdf_guidance.phone")
PLACES = {"entrance": [0.9, 0.9], "cupboard": [2.4, 1.2], "window": [5.4, 3.4]}


def held(x, z, yaw, y=1.2, stamp=0.0, pitch=0.0, **options):
    """A phone at x and z, turned by `yaw` to the left [rad] and down by `pitch`."""
    half, tip = yaw / 2, -pitch / 2
    q = (math.cos(half) * math.sin(tip), math.sin(half) * math.cos(tip), -math.sin(half) * math.sin(tip))
    return Tracked((x, y, z), (*q, math.cos(half) * math.cos(tip)), stamp, **options)


def test_a_phone_that_looks_ahead_looks_along_minus_z():
    assert held(0, 0, 0.0).heading == pytest.approx(math.pi / 2)
    assert held(0, 0, math.pi / 2).heading == pytest.approx(math.pi)  # to the left is to the left
    assert held(0, 0, 0.7, pitch=math.radians(85)).heading == pytest.approx(math.pi / 2 + 0.7)  # looks at the floor


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_a_phone_is_tied_to_the_place_and_direction_and_moves_with_the_person(yaw):
    known = align(held(3.0, -2.0, yaw), (10.0, 5.0, 1.7), math.pi, None, DRIFT)
    here = to_pose(known, held(3.0, -2.0, yaw))
    assert here.position == pytest.approx([10.0, 5.0, 1.7])
    assert math.cos(here.heading) == pytest.approx(-1.0)
    forward = (-math.sin(yaw), -math.cos(yaw))  # in x and z
    on = held(3.0 + 2 * forward[0], -2.0 + 2 * forward[1], yaw, y=1.2 + 0.17)
    assert to_pose(known, on).position == pytest.approx([8.0, 5.0, 1.87])
    turned = to_pose(known, held(3.0, -2.0, yaw + math.pi / 2))
    assert math.sin(turned.heading - here.heading) == pytest.approx(1.0)
    assert math.dist(turned.position[:2], here.position[:2]) == pytest.approx(AHEAD * math.sqrt(2))


def test_what_is_believed_falls_with_the_way_and_rises_at_a_place():
    known = align(held(0, 0, 0.0), (0.0, 0.0, 0.0), 0.0, None, DRIFT)
    accuracies = []
    for step in range(1, 101):
        known = walk_on(known, held(0, -0.1 * step, 0.0))
        accuracies.append(to_pose(known, held(0, -0.1 * step, 0.0)).accuracy)
    assert accuracies == sorted(accuracies)
    assert accuracies[20] < UNRELIABLE < accuracies[-1]  # within ten metres the guide does not believe it any more
    again = align(held(0, -10.0, 0.0), (10.0, 0.3, 0.0), None, known, DRIFT)
    assert to_pose(again, held(0, -10.0, 0.0)).accuracy < UNRELIABLE
    assert to_pose(again, held(0, -10.0, 0.0)).heading == pytest.approx(0.0)
    assert to_pose(again, held(0, -10.0, 0.0, tracked=False)).accuracy > UNRELIABLE
    with pytest.raises(ValueError, match="looks"):
        align(held(0, 0, 0.0), (0.0, 0.0, 0.0), None, None, DRIFT)


def test_a_pose_that_was_held_up_on_its_way_is_as_old_as_it_is():
    clock = Clock()
    assert clock.to_ours(100.0, 1000.05) == pytest.approx(1000.05)
    assert clock.to_ours(100.1, 1000.12) == pytest.approx(1000.12)
    assert clock.to_ours(100.2, 1005.2) == pytest.approx(1000.22)  # five seconds in the network
    assert clock.to_theirs(1000.35) == pytest.approx(100.33)
    assert Clock().to_theirs(1000.0) is None


class Streams:
    """A Zenoh session that keeps what is put."""

    def __init__(self):
        self.put_on = []

    def put(self, key, payload):
        self.put_on.append((key, bytes(payload)))


def test_messages_of_the_page_become_poses_and_asks_and_nonsense_nothing():
    streams = Streams()
    phone = phone_module.Phone(streams, "anna", lambda: PLACES)
    pose = {"type": "pose", "position": [0, 1.2, 0], "orientation": [0, 0, 0, 1], "time": 5.0, "tracked": True}
    assert phone.take(json.dumps(pose)) is None
    assert streams.put_on == []  # nobody knows yet where that is
    assert phone.take(json.dumps({"type": "here", "place": "entrance"})) == {"type": "here", "fine": False}
    here = {"type": "here", "place": "entrance", "facing": "window"}
    assert phone.take(json.dumps(here)) == {"type": "here", "fine": True}
    assert phone.take(json.dumps(pose))["accuracy"] == 0.05
    assert phone.take(json.dumps(pose)) is None  # nothing new for who looks at the page
    phone.hello()  # another page
    assert phone.take(json.dumps(pose))["accuracy"] == 0.05
    key, data = streams.put_on[0]
    assert key == f"{keys.POSE}/anna"
    assert decode(data, PoseMessage).position == pytest.approx([0.9, 0.9, 0.0])
    assert decode(data, PoseMessage).heading == pytest.approx(math.atan2(2.5, 4.5))
    phone.take(json.dumps({"type": "ask", "ask": "how_far", "id": "7"}))
    assert decode(streams.put_on[-1][1], AskMessage).id == "7"
    for wrong in (
        {"type": "ask", "ask": "dance"},
        {"type": "nothing"},
        [],
        {**pose, "position": [1, 2]},
        {**pose, "position": [1, 2, math.nan]},
    ):
        with pytest.raises(ValueError):  # noqa: PT011 - of many kinds
            phone.take(json.dumps(wrong))


@pytest.fixture
def served(tmp_path, request):
    phone = phone_module.Phone(Streams(), "anna", lambda: PLACES, language=getattr(request, "param", "en"))
    with phone_module.PhoneServer(phone, tmp_path, "127.0.0.1") as server:
        yield server


def fetched(url):
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with urllib.request.urlopen(url, context=context, timeout=10) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, ""


def test_the_page_is_served_to_who_has_the_token(served):
    base = f"https://127.0.0.1:{served.port}"
    assert fetched(served.url)[0] == 200
    assert "I stand at" in fetched(served.url)[1]
    assert fetched(f"{base}/")[0] == fetched(f"{base}/?token=x")[0] == fetched(f"{base}/socket?token=x")[0] == 403
    assert fetched(f"{base}/../pyproject.toml")[0] == 404


@pytest.mark.parametrize("served", ["de"], indirect=True)
def test_the_page_speaks_the_guides_language_before_it_is_connected(served):
    page = fetched(served.url)[1]
    assert '<html lang="de">' in page
    assert ">Ich stehe bei<" in page
    assert "{{" not in page
    texts = json.loads(page.split('id="texts">')[1].split("</script>")[0])
    assert (texts["stop_alone"], texts["no"]) == ("Halt. Ich habe keine Verbindung.", "Nein")


def test_the_certificate_is_made_once_and_for_these_addresses(tmp_path):
    chain, key = phone_module.certificate(tmp_path, ["127.0.0.1"])
    first = chain.read_bytes()
    assert phone_module.certificate(tmp_path, ["127.0.0.1"])[0].read_bytes() == first
    assert phone_module.certificate(tmp_path, ["127.0.0.1", "192.0.2.7"])[0].read_bytes() != first
    assert key.stat().st_mode & 0o077 == 0


def test_the_qr_code_is_one():
    pytest.importorskip("segno")
    assert len(phone_module.qr_code("https://192.0.2.7:8443/?token=abc").splitlines()) > 10
