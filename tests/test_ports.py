import socket
import subprocess
import sys

import pytest

from gpdf_service import ports
from gpdf_service.ports import LAST_PORT, REGISTERED, free_port, trouble_at


@pytest.mark.skipif(not ports.EPHEMERAL.exists(), reason="other systems have no names that end with a process")
def test_two_processes_are_given_different_ports_and_none_that_connections_get():
    low, high = map(int, ports.EPHEMERAL.read_text().split())
    mine = [free_port() for _ in range(3)]
    code = f"import os; os.getpid = lambda: {mine[0] - ports.FIRST_PORT}; from gpdf_service.ports import free_port"
    words = [sys.executable, "-c", f"{code}; print(free_port(), free_port(), free_port())"]
    theirs = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    given = [*mine, *map(int, theirs.split())]
    assert len(set(given)) == 6
    assert not any(low <= port <= high for port in given)


def test_a_system_that_tells_nothing_of_its_ports_has_free_ones_too(monkeypatch, tmp_path):
    monkeypatch.setattr("gpdf_service.ports.EPHEMERAL", tmp_path / "none")
    given = {free_port() for _ in range(3)}
    assert len(given) == 3
    assert not any(REGISTERED[0] <= port <= LAST_PORT for port in given)


def test_a_port_that_somebody_listens_on_is_not_given(monkeypatch, tmp_path):
    monkeypatch.setattr("gpdf_service.ports.EPHEMERAL", tmp_path / "none")
    monkeypatch.setattr("gpdf_service.ports._given", {})
    first = free_port()
    monkeypatch.setattr("gpdf_service.ports._given", {})
    with socket.create_server(("127.0.0.1", first)):
        assert free_port() != first


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "0.0.0.0", "::"])
def test_why_nobody_can_listen_is_told_of_each_kind_of_address(host):
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.create_server((host, 0), family=family) as other:
        port = other.getsockname()[1]
        assert trouble_at(host, port) == "Address already in use"
    assert trouble_at(host, port) == ""
    assert "0-65535" in trouble_at(host, 65_536)


def test_a_name_of_which_this_machine_has_but_one_address_can_be_listened_on(monkeypatch):
    stream = socket.AF_INET, socket.SOCK_STREAM, 0, ""
    both = [(*stream, ("192.0.2.1", 0)), (*stream, ("127.0.0.1", 0))]  # as localhost, where IPv6 is off
    monkeypatch.setattr("socket.getaddrinfo", lambda *_, **__: both)
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert trouble_at("localhost", port) == "Address already in use"
    assert trouble_at("localhost", port) == ""


def test_who_is_no_address_of_this_machine_is_told_so():
    assert trouble_at("192.0.2.1", 7447) == "Cannot assign requested address"  # RFC 5737: nobody's
    assert trouble_at("nobody.invalid", 7447)  # RFC 2606; the words are the resolver's
