"""The guide in a phone's browser: a page over HTTPS, poses and asks in, cues and sentences out over its web socket.

Needs the extra `phone` (websockets, cryptography, segno).
"""

from __future__ import annotations

import hmac
import json
import re
import secrets
import socket
import ssl
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from html import escape
from importlib import resources
from ipaddress import ip_address
from math import atan2
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import zenoh
from gpdf_schemas import Ask, AskMessage, CueMessage, DecodeError, SayMessage, decode, encode, keys

from gpdf_guidance.alignment import DRIFT, Alignment, Clock, Tracked, align, to_pose, walk_on
from gpdf_guidance.catalogue import language
from gpdf_guidance.instruction import Kind

PAGES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/guide.js": ("guide.js", "text/javascript; charset=utf-8"),
    "/guide.css": ("guide.css", "text/css; charset=utf-8"),
}
SAFE = {
    "Content-Security-Policy": "default-src 'self'; connect-src 'self'; frame-ancestors 'none'",
    "Permissions-Policy": "xr-spatial-tracking=(self), microphone=(self)",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
MARK = re.compile(r"{{(\w+)}}")
"""Where a text stands in the page."""
LARGEST = 4096
"""[bytes] Of a message from the page."""
VALID_DAYS = 30
Places = dict[str, list[float]]


@dataclass(slots=True)
class Phone:
    """One person's phone: ties its tracking to the scene, and passes on what comes and goes.

    Args:
        session: Where the streams are.
        name: Of the person, the last part of the streams' keys.
        places: Asked for the scene's named places [m].
        goal: What the person calls the goal.
        language: Of the page, and of the words that it says itself.
        drift: Metres that the phone's tracking loses in a metre.
    """

    session: zenoh.Session
    name: str
    places: Callable[[], Places]
    goal: str = ""
    language: str = "en"
    drift: float = DRIFT
    alignment: Alignment | None = None
    clock: Clock = field(default_factory=Clock)
    _seen: Tracked | None = None
    _drift_told: float = -1.0

    def hello(self) -> dict[str, Any]:
        """What the page needs to begin."""
        self._drift_told = -1.0
        return {"type": "hello", "places": sorted(self.places()), "goal": self.goal}

    def take(self, text: str | bytes) -> dict[str, Any] | None:
        """Take a message of the page; what it is told.

        Raises:
            ValueError: it makes no sense.
        """
        message = json.loads(text)
        kind = message.get("type") if isinstance(message, dict) else None
        if kind == "pose":
            return self._take_pose(message)
        if kind == "here":
            return self._take_here(message)
        if kind == "ask":
            ask = AskMessage(
                ask=Ask(message["ask"]), id=str(message.get("id", "")), goal=message.get("goal"), stamp=time.time()
            )
            self.session.put(f"{keys.ASK}/{self.name}", encode(ask))
            return None
        raise ValueError(f"a message of type {kind!r}: send pose, here or ask")

    def _take_pose(self, message: dict[str, Any]) -> dict[str, Any] | None:
        p, q = [float(v) for v in message["position"]], [float(v) for v in message["orientation"]]
        if len(p) != 3 or len(q) != 4 or not all(abs(v) < 1e4 for v in (*p, *q)):
            raise ValueError("a pose has a position (3) and an orientation (4)")
        stamp = self.clock.to_ours(float(message["time"]), time.time())
        steps = message.get("steps")
        tracked = message.get("tracked") is True
        place, turn = (p[0], p[1], p[2]), (q[0], q[1], q[2], q[3])
        self._seen = Tracked(place, turn, stamp, tracked, None if steps is None else int(steps))
        if self.alignment is None:
            return None
        self.alignment = walk_on(self.alignment, self._seen)
        pose = to_pose(self.alignment, self._seen)
        self.session.put(f"{keys.POSE}/{self.name}", encode(pose))
        accuracy = round(pose.accuracy, 2)
        if accuracy == self._drift_told:
            return None  # the page shows whole centimetres
        self._drift_told = accuracy
        return {"type": "drift", "accuracy": accuracy, "walked": round(self.alignment.walked, 2)}

    def _take_here(self, message: dict[str, Any]) -> dict[str, Any]:
        """The person says at which place he stands, and, the first time, which one he faces."""
        places, at, toward = self.places(), message.get("place"), message.get("facing")
        if self._seen is None or at not in places or (toward is not None and toward not in places):
            return {"type": "here", "fine": False}
        x, y, *z = places[at]
        facing = None if toward is None else atan2(places[toward][1] - y, places[toward][0] - x)
        try:
            self.alignment = align(self._seen, (x, y, z[0] if z else 0.0), facing, self.alignment, self.drift)
        except ValueError:
            return {"type": "here", "fine": False}
        return {"type": "here", "fine": True}


def render(body: str, tag: str) -> str:
    """The page in a language: each {{name}} is its text, {{texts}} all that the page shows and says by itself."""
    words = language(tag)
    texts = json.dumps({**words.page, Kind.STOP_ALONE.value: words.sentences[Kind.STOP_ALONE]}).replace("<", "\\u003c")
    filled = {**{name: escape(text) for name, text in words.page.items()}, "language": tag, "texts": texts}
    return MARK.sub(lambda mark: filled[mark[1]], body)


def to_page(kind: str, sample: zenoh.Sample, clock: Clock) -> str | None:
    """A cue or a sentence as the page reads it, with its times on the phone's clock; None for what is none.

    The page sees by them what a bad connection brings too late.
    """
    with suppress(DecodeError):
        data = sample.payload.to_bytes()
        if kind == "cue":
            cue = decode(data, CueMessage)
            times = {
                "sent": clock.to_theirs(cue.stamp),
                "pose": clock.to_theirs(cue.pose_stamp) if cue.pose_stamp else None,
            }
            return json.dumps({"type": "cue", "action": cue.action, "direction": cue.direction, **times})
        said = decode(data, SayMessage)
        return json.dumps(
            {
                "type": "say",
                "text": said.text,
                "urgency": said.urgency,
                "answers": [answer.value for answer in said.answers],
                "until": clock.to_theirs(said.valid_until),
            }
        )
    return None


class PhoneServer:
    """Serves the page and its web socket, to who has the token.

    Args:
        phone: Whose.
        folder: Keeps the certificate and its key.
        host: Address to listen at.
        port: 0 for any.
    """

    def __init__(self, phone: Phone, folder: Path, host: str = "0.0.0.0", port: int = 0) -> None:
        from websockets.sync.server import serve

        self._phone, self.token = phone, secrets.token_urlsafe(16)
        names = [host] if host not in ("0.0.0.0", "") else ["127.0.0.1", own_address()]
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(*certificate(folder, names))
        self._server = serve(
            self._talk, host, port, ssl=context, process_request=self._answer, max_size=LARGEST, compression=None
        )
        self.port: int = self._server.socket.getsockname()[1]
        self.url = f"https://{names[-1]}:{self.port}/?token={self.token}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="gpdf-phone", daemon=True)

    def __enter__(self) -> PhoneServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._thread.join()

    def _answer(self, connection: Any, request: Any) -> Any:  # noqa: ANN401 - of websockets, an extra
        """The page's files; the socket and the page itself only with the token."""
        from websockets.datastructures import Headers
        from websockets.http11 import Response

        url = urlsplit(request.path)
        given = parse_qs(url.query).get("token", [""])[0]
        if url.path in ("/", "/socket") and not hmac.compare_digest(given.encode(), self.token.encode()):
            return connection.respond(403, "Open the link with its token.\n")
        if url.path == "/socket":
            return None
        if url.path not in PAGES:
            return connection.respond(404, "There is no such page.\n")
        name, kind = PAGES[url.path]
        body = resources.files("gpdf_guidance").joinpath("page", name).read_bytes()
        if url.path == "/":
            body = render(body.decode(), self._phone.language).encode()
        headers = {"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close", **SAFE}
        return Response(200, "OK", Headers(headers), body)

    def _talk(self, socket: Any) -> None:  # noqa: ANN401 - of websockets, an extra
        """Pass messages on until the page goes."""
        from websockets.exceptions import ConnectionClosed

        session, name, clock = self._phone.session, self._phone.name, self._phone.clock

        def send(text: str | None) -> None:
            with suppress(ConnectionClosed):
                if text is not None:
                    socket.send(text)

        streams = [
            session.declare_subscriber(f"{keys.CUE}/{name}", lambda sample: send(to_page("cue", sample, clock))),
            session.declare_subscriber(f"{keys.SAY}/{name}", lambda sample: send(to_page("say", sample, clock))),
        ]
        try:
            send(json.dumps(self._phone.hello()))
            for text in socket:
                try:
                    answer = self._phone.take(text)
                except (ValueError, KeyError, TypeError, RecursionError):
                    answer = {"type": "error"}
                send(None if answer is None else json.dumps(answer))
        finally:
            for stream in streams:
                stream.undeclare()  # type: ignore[no-untyped-call]


def own_address() -> str:
    """This machine's address in the network that it would reach others by; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return "127.0.0.1"
        return str(probe.getsockname()[0])


def certificate(folder: Path, names: Sequence[str]) -> tuple[Path, Path]:
    """A certificate for these addresses and its key, made where there is none that is good for a day.

    A browser asks once whether to trust it; a new one at each start would make it ask each time.
    """
    from cryptography import x509

    chain, key = folder / "phone.crt", folder / "phone.key"
    if chain.is_file() and key.is_file():
        known = x509.load_pem_x509_certificate(chain.read_bytes())
        alternatives = known.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        covered = {str(one) for one in alternatives.get_values_for_type(x509.IPAddress)}
        if set(names) <= covered and known.not_valid_after_utc > datetime.now(UTC) + timedelta(days=1):
            return chain, key
    _make_certificate(chain, key, names)
    return chain, key


def _make_certificate(chain: Path, key: Path, names: Sequence[str]) -> None:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    chain.parent.mkdir(parents=True, exist_ok=True)
    secret, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    who = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "gpdf guide")])
    made = (
        x509.CertificateBuilder()
        .subject_name(who)
        .issuer_name(who)
        .public_key(secret.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(minutes=5))
        .not_valid_after(now + timedelta(days=VALID_DAYS))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ip_address(name)) for name in names]), False)
        .sign(secret, hashes.SHA256())
    )
    pem, plain = serialization.Encoding.PEM, serialization.NoEncryption()
    key.touch(mode=0o600)
    key.write_bytes(secret.private_bytes(pem, serialization.PrivateFormat.PKCS8, plain))
    chain.write_bytes(made.public_bytes(pem))


def qr_code(url: str) -> str:
    """A QR code for a terminal."""
    import io

    import segno

    out = io.StringIO()
    segno.make(url, error="m").terminal(out, compact=True)
    return out.getvalue()
