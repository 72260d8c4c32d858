"""A door with a lock before the page: who has the link's token gets a cookie, who has neither gets nothing.

viser has no login, so it listens where nobody finds it and the gate passes bytes on. A browser asks on behalf of every
page that it shows: so the gate also looks by which name it is asked (a name of somebody else's that points here would
make their page ours), and which page asks. There is no encryption here: over a network that others share, put the page
behind TLS (a reverse proxy, or an SSH tunnel to 127.0.0.1).
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import secrets
import socket
import threading
from collections.abc import Collection
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

HEAD_BYTES = 16_384
"""Longest head of a request that is read."""
HEAD_S = 10.0
"""[s] It must be there by then."""
CHUNK_BYTES = 65_536
COOKIE = "gpdf_token"


@dataclass(frozen=True, slots=True)
class _Head:
    """What the first lines of a request say; header names in lower case."""

    path: str
    headers: dict[str, str]
    cookies: dict[str, str]

    @property
    def is_upgrade(self) -> bool:
        """Whether it asks for a websocket."""
        return self.headers.get("upgrade", "").lower() == "websocket"


def hidden_address() -> str:
    """An address of this machine alone that no page in a browser can guess: one of sixteen million, for Linux."""
    return f"127.{1 + secrets.randbelow(254)}.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"


class Gate:
    """Listens on `host`:`port`, and passes what carries the token on to the page.

    Args:
        host: Address to listen on.
        port: Port to listen on.
        inner: Address and port of the page.
        token: Who has it may see the page.
        names: By which the gate may be asked, beside addresses and localhost.
        front: What is at "/", in place of what the page has there.

    Raises:
        OSError: it cannot listen there.
    """

    def __init__(
        self,
        host: str,
        port: int,
        inner: tuple[str, int],
        token: str,
        names: Collection[str] = (),
        front: bytes | None = None,
    ) -> None:
        self._inner, self._token, self._front = inner, token, front
        self._names = {"localhost", host.lower(), *(name.lower() for name in names)}
        self._cookie = f"{COOKIE}_{port}"  # cookies know no ports
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.create_server((host, port), family=family)
        self._loop, self._closing = asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="gpdf-gate", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._socket.getsockname()[1])

    def close(self) -> None:
        """Shut the door, also on those inside."""
        self._loop.call_soon_threadsafe(self._closing.set)
        self._thread.join()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:  # at its end it cancels what still runs
            runner.run(self._listen())

    async def _listen(self) -> None:
        server = await asyncio.start_server(self._serve, sock=self._socket, limit=HEAD_BYTES)
        await self._closing.wait()
        server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
            asked = _read_head(head)
            if (refusal := self._refusal(asked)) is not None:
                writer.write(refusal)
            elif self._is_right(parse_qs(urlsplit(asked.path).query).get("token", [""])[0]):
                writer.write(self._welcome())
            elif not self._is_right(asked.cookies.get(self._cookie, "")):
                writer.write(_REFUSAL)
            elif self._front is not None and asked.path == "/" and not asked.is_upgrade:
                writer.write(_page(self._front))
            else:
                await self._pass_on(head, reader, writer, both_ways=asked.is_upgrade)
            await writer.drain()
        except (OSError, ValueError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # a visitor that is no browser, or one that has left
        finally:
            writer.close()

    def _refusal(self, asked: _Head) -> bytes | None:
        """Why it is not even looked at the token, if it is not."""
        host = asked.headers.get("host", "")
        if not self._is_known(host):
            return _WRONG_HOST
        origin = asked.headers.get("origin")
        wanted = f"http://{host}", f"https://{host}"  # behind a proxy the page is https
        if (origin is None and asked.is_upgrade) or (origin is not None and origin.lower() not in wanted):
            return _WRONG_ORIGIN
        return None

    def _is_known(self, host: str) -> bool:
        """Whether it is an address, or a name that is ours: any other may be one that its owner made point here."""
        name = (urlsplit(f"//{host}").hostname or "").lower()
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in self._names
        return True

    def _is_right(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())

    def _welcome(self) -> bytes:
        """A cookie in place of the token, which so leaves the address bar and is in no later log."""
        cookie = f"{self._cookie}={self._token}; HttpOnly; SameSite=Lax; Path=/"
        return _answer("303 See Other", f"Location: /\r\nSet-Cookie: {cookie}\r\nCache-Control: no-store\r\n", "")

    async def _pass_on(
        self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, both_ways: bool
    ) -> None:
        """A websocket, or this one request: the next on the same connection has not shown anything yet."""
        inner_reader, inner_writer = await asyncio.open_connection(*self._inner)
        try:
            inner_writer.write(head if both_ways else _last(head))
            ways = {asyncio.create_task(_copy(inner_reader, writer))}
            if both_ways:
                ways.add(asyncio.create_task(_copy(reader, inner_writer)))
            _, left = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            for task in left:
                task.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
        finally:
            inner_writer.close()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(CHUNK_BYTES):
        writer.write(data)
        await writer.drain()


def _last(head: bytes) -> bytes:
    """The request as the only one of its connection."""
    first, *lines = head.rstrip(b"\r\n").split(b"\r\n")
    kept = [line for line in lines if line.partition(b":")[0].lower() not in (b"connection", b"keep-alive")]
    return b"\r\n".join([first, *kept, b"Connection: close", b"", b""])


def _read_head(head: bytes) -> _Head:
    """What a request says of itself.

    Raises:
        ValueError: it is none, or says one thing twice.
    """
    first, *lines = head.decode("latin-1").split("\r\n")
    _, path, _ = first.split(" ", 2)
    pairs = [(name.strip().lower(), value.strip()) for name, _, value in (line.partition(":") for line in lines)]
    names = [name for name, _ in pairs if name in ("host", "origin", "upgrade")]
    if len(set(names)) < len(names):
        raise ValueError("a header that is there twice")
    try:
        jar = {key: morsel.value for n, v in pairs if n == "cookie" for key, morsel in SimpleCookie(v).items()}
    except CookieError as error:
        raise ValueError(str(error)) from error
    return _Head(path, dict(pairs), jar)


def _answer(status: str, headers: str, text: str) -> bytes:
    body = text.encode()
    return (
        f"HTTP/1.1 {status}\r\n{headers}Content-Type: text/plain; charset=utf-8\r\n"
        f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    ).encode() + body


def _page(body: bytes) -> bytes:
    head = "HTTP/1.1 200 OK\r\nContent-Type: text/html; charset=utf-8\r\nCache-Control: no-store\r\n"
    return f"{head}Content-Length: {len(body)}\r\nConnection: close\r\n\r\n".encode() + body


_WRONG_HOST = _answer("421 Misdirected Request", "", "This page is not known by that name: gpdf view --name NAME.\n")
_WRONG_ORIGIN = _answer("403 Forbidden", "", "Another page may not ask on your behalf.\n")
_REFUSAL = _answer("403 Forbidden", "", "Open the link that `gpdf view` printed: it carries the token.\n")
