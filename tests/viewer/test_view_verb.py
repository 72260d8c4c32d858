import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from urllib.error import HTTPError

import psutil
import pytest

from gpdf_service.cli import main
from gpdf_service.ports import free_port


def start(*words):
    return subprocess.Popen(
        [sys.executable, "-m", "gpdf_service.cli", "view", *words], stdout=subprocess.PIPE, env=os.environ, text=True
    )


def link_of(process):
    """What it prints first: no other address stands beside it."""
    line = process.stdout.readline()
    found = re.fullmatch(r"open (http://\S+)\n", line)
    assert found, line
    return found[1]


def fetch(link):
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    return opener.open(link, timeout=30).read().decode()


def test_the_page_is_for_this_machine_unless_told_otherwise(free_endpoint):
    port = free_port()
    with start("--endpoint", free_endpoint, "--port", str(port)) as process:
        try:
            link = link_of(process)
            assert link.startswith(f"http://127.0.0.1:{port}/?token=")  # whoever has an account here is no operator
            assert "<html" in fetch(link)
            with pytest.raises(HTTPError, match="403"):
                fetch(link.partition("?")[0])
            listens = [
                one.laddr.port
                for one in psutil.Process(process.pid).net_connections("tcp")
                if one.status == psutil.CONN_LISTEN and one.laddr.ip in ("127.0.0.1", "0.0.0.0", "::", "::1")
            ]
            assert listens == [port]  # the page behind the gate is where nobody looks
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 0
            assert process.stdout.read() == ""  # nor anything at its end
        finally:
            process.kill()


def test_the_address_that_is_asked_for_is_the_one_in_the_link(free_endpoint):
    with start("--endpoint", free_endpoint, "--host", "127.0.0.2", "--port", str(free_port())) as process:
        try:
            link = link_of(process)
            assert link.startswith("http://127.0.0.2:")
            assert "<html" in fetch(link)
        finally:
            process.kill()


def test_for_other_machines_the_link_carries_a_token(free_endpoint):
    with start("--endpoint", free_endpoint, "--host", "0.0.0.0", "--port", str(free_port())) as process:
        try:
            link = link_of(process).replace("0.0.0.0", "127.0.0.1")
            assert "?token=" in link
            with pytest.raises(HTTPError, match="403"):
                fetch(link.partition("?")[0])
            assert "<html" in fetch(link)
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) == 0
        finally:
            process.kill()


@pytest.mark.slow
def test_the_page_works_in_a_browser_through_the_gate(browser, service):
    with start("--endpoint", service.endpoint, "--host", "0.0.0.0", "--port", str(free_port())) as process:
        context = browser.new_context()
        try:
            web = context.new_page()
            link = link_of(process).replace("0.0.0.0", "127.0.0.1")
            web.goto(link)
            web.get_by_text("Connected to").wait_for(timeout=60_000)  # said over the websocket
            assert "token" not in web.url
        finally:
            context.close()
            process.kill()


def test_a_log_that_is_not_there_and_a_port_that_is_taken_are_failures(tmp_path, capsys, free_endpoint):
    for host, family in (("127.0.0.1", socket.AF_INET), ("::1", socket.AF_INET6)):
        with socket.create_server((host, 0), family=family) as taken:
            port = taken.getsockname()[1]
            assert main(["view", "--host", host, "--port", str(port)]) == 1
            assert f"cannot listen on {host}:{port}: Address already in use" in capsys.readouterr().err
    assert main(["view", "--log", str(tmp_path / "none.mcap")]) == 1
    assert main(["view", "--zenoh", str(tmp_path / "none.json5")]) == 1
    said = capsys.readouterr().err
    assert "no log" in said
    assert "none.json5 is no Zenoh configuration" in said
