import http.client
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from driving import free_port

from gpdf_service.viewer.gate import Gate

TOKEN = "a-token"


class Echo(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self):
        body = f"inside {self.path}".encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *args):
        """Say nothing."""


@pytest.fixture(scope="module")
def gate():
    inner = ThreadingHTTPServer(("127.0.0.1", 0), Echo)
    threading.Thread(target=inner.serve_forever, daemon=True).start()
    made = Gate("127.0.0.1", free_port(), inner.server_port, TOKEN)
    yield made
    made.close()
    inner.shutdown()


def get(gate, path, cookie=None, connection=None):
    made = connection or http.client.HTTPConnection("127.0.0.1", gate.port, timeout=30)
    made.request("GET", path, headers={"Cookie": cookie} if cookie else {})
    answer = made.getresponse()
    return answer, answer.read().decode()


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=wrong", "/?token=a-tokenx", "/index.html?tok=a-token"])
def test_without_the_token_nothing_is_seen(gate, path):
    answer, text = get(gate, path)
    assert answer.status == 403
    assert "inside" not in text
    assert TOKEN not in text


@pytest.mark.parametrize("cookie", ["gpdf_token=a-token", "gpdf_token_{port}=wrong", "gpdf_token_{port}="])
def test_a_wrong_cookie_opens_nothing(gate, cookie):
    answer, text = get(gate, "/", cookie.format(port=gate.port))
    assert answer.status == 403
    assert "inside" not in text


def test_the_token_becomes_a_cookie_that_opens(gate):
    answer, _ = get(gate, f"/?token={TOKEN}")
    assert answer.status == 303
    assert answer.headers["Location"] == "/"  # the token leaves the address bar
    words = answer.headers["Set-Cookie"]
    assert "HttpOnly" in words
    assert "SameSite" in words
    cookie = words.partition(";")[0]
    connection = http.client.HTTPConnection("127.0.0.1", gate.port, timeout=30)
    assert get(gate, "/a", cookie, connection)[1] == "inside /a"
    assert get(gate, "/b", cookie, connection)[1] == "inside /b"  # the same connection goes on


@pytest.mark.parametrize(
    "head", [b"\r\n\r\n", b"GET\r\n\r\n", b"\x16\x03\x01\r\n\r\n", b"x" * 40_000, b"GET / HTTP/1.1\r\n"]
)
def test_garbage_is_shut_out_and_the_gate_stays_open(gate, head):
    import socket

    with socket.create_connection(("127.0.0.1", gate.port), timeout=30) as visitor:
        visitor.sendall(head)
        visitor.shutdown(socket.SHUT_WR)
        try:
            said = visitor.recv(1000)
        except ConnectionResetError:
            said = b""
    assert b"inside" not in said
    assert get(gate, "/")[0].status == 403


def test_a_port_that_is_taken_is_an_error(gate):
    with pytest.raises(OSError, match="in use"):
        Gate("127.0.0.1", gate.port, 1, TOKEN)
