"""A door with a lock before the page: who has the link's token gets a cookie, who has neither gets nothing.

viser has no login, so it listens on this machine alone and the gate passes bytes on. There is no encryption here: over
a network that others share, put the page behind TLS (a reverse proxy, or an SSH tunnel to 127.0.0.1).
"""

from __future__ import annotations

import asyncio
import hmac
import socket
import threading
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

HEAD_BYTES = 16_384
"""Longest head of a request that is read."""
HEAD_S = 10.0
"""[s] It must be there by then."""
CHUNK_BYTES = 65_536
COOKIE = "gpdf_token"


class Gate:
    """Listens on `host`:`port`, and passes what carries the token on to 127.0.0.1:`inner_port`.

    Raises:
        OSError: it cannot listen there.
    """

    def __init__(self, host: str, port: int, inner_port: int, token: str) -> None:
        self._inner_port, self._token = inner_port, token
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
            path, cookies = _read_head(head)
            if self._is_right(parse_qs(urlsplit(path).query).get("token", [""])[0]):
                writer.write(self._welcome())
            elif self._is_right(cookies.get(self._cookie, "")):
                await self._pass_on(head, reader, writer)
            else:
                writer.write(_REFUSAL)
            await writer.drain()
        except (OSError, ValueError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # a visitor that is no browser, or one that has left
        finally:
            writer.close()

    def _is_right(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())

    def _welcome(self) -> bytes:
        """A cookie in place of the token, which so leaves the address bar and is in no later log."""
        cookie = f"{self._cookie}={self._token}; HttpOnly; SameSite=Lax; Path=/"
        return _answer("303 See Other", f"Location: /\r\nSet-Cookie: {cookie}\r\nCache-Control: no-store\r\n", "")

    async def _pass_on(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """All that this connection says: it has shown the cookie."""
        inner_reader, inner_writer = await asyncio.open_connection("127.0.0.1", self._inner_port)
        try:
            inner_writer.write(head)
            ways = {
                asyncio.create_task(_copy(reader, inner_writer)),
                asyncio.create_task(_copy(inner_reader, writer)),
            }
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


def _read_head(head: bytes) -> tuple[str, dict[str, str]]:
    """Path and cookies of a request.

    Raises:
        ValueError: it is none.
    """
    first, *lines = head.decode("latin-1").split("\r\n")
    _, path, _ = first.split(" ", 2)
    jar: dict[str, str] = {}
    for line in lines:
        name, _, value = line.partition(":")
        if name.lower() == "cookie":
            try:
                jar |= {key: morsel.value for key, morsel in SimpleCookie(value.strip()).items()}
            except CookieError as error:
                raise ValueError(str(error)) from error
    return path, jar


def _answer(status: str, headers: str, text: str) -> bytes:
    body = text.encode()
    return (
        f"HTTP/1.1 {status}\r\n{headers}Content-Type: text/plain; charset=utf-8\r\n"
        f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    ).encode() + body


_REFUSAL = _answer("403 Forbidden", "", "Open the link that `gpdf view` printed: it carries the token.\n")
