import http.client
import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from gpdf_service.ports import free_port
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
    made = Gate("127.0.0.1", free_port(), ("127.0.0.1", inner.server_port), TOKEN, ["gpdf.Example"])
    yield made
    made.close()
    inner.shutdown()


def get(gate, path, cookie=None, **headers):
    made = http.client.HTTPConnection("127.0.0.1", gate.port, timeout=30)
    made.request("GET", path, headers=({"Cookie": cookie} if cookie else {}) | headers)
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
    assert get(gate, "/a", cookie)[1] == "inside /a"


def cookie_of(gate):
    return f"gpdf_token_{gate.port}={TOKEN}"


def test_what_follows_on_an_open_connection_has_to_show_its_own_cookie(gate):
    request = f"GET /a HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: keep-alive\r\nCookie: {cookie_of(gate)}\r\n\r\n"
    with socket.create_connection(("127.0.0.1", gate.port), timeout=30) as visitor:
        visitor.sendall(request.encode() + b"GET /b HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        said = b"".join(iter(lambda: visitor.recv(10_000), b""))
    assert b"inside /a" in said
    assert b"inside /b" not in said


UPGRADE = {"Upgrade": "websocket", "Connection": "Upgrade"}


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "http://evil.example", **UPGRADE},
        {"Origin": "null", **UPGRADE},
        {"Origin": "http://127.0.0.1:1", **UPGRADE},  # another port is another page
        UPGRADE,  # each browser says which page it is
    ],
)
def test_no_other_page_asks_on_the_operators_behalf(gate, headers):
    answer, text = get(gate, "/a", cookie_of(gate), **headers)
    assert answer.status == 403
    assert "inside" not in text


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
def test_a_name_that_somebody_made_point_here_shows_nothing(gate, host):
    for path in ("/a", f"/?token={TOKEN}"):
        answer, text = get(gate, path, cookie_of(gate), Host=host)
        assert answer.status == 421
        assert "inside" not in text


@pytest.mark.parametrize(
    "host", ["127.0.0.1", "localhost:{port}", "[::1]:{port}", "192.168.1.5:{port}", "gpdf.example"]
)
def test_the_page_is_known_by_its_addresses_and_the_names_that_it_was_given(gate, host):
    host = host.format(port=gate.port)
    assert get(gate, "/a", cookie_of(gate), Host=host)[1] == "inside /a"
    assert get(gate, "/a", cookie_of(gate), Host=host, Origin=f"http://{host}")[1] == "inside /a"
    assert get(gate, "/a", cookie_of(gate), Host=host, Origin=f"https://{host}")[1] == "inside /a"


@pytest.mark.parametrize(
    "head", [b"\r\n\r\n", b"GET\r\n\r\n", b"\x16\x03\x01\r\n\r\n", b"x" * 40_000, b"GET / HTTP/1.1\r\n"]
)
def test_garbage_is_shut_out_and_the_gate_stays_open(gate, head):
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
        Gate("127.0.0.1", gate.port, ("127.0.0.1", 1), TOKEN)
