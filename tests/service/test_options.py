import json
import logging
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from gpdf_service.cli import main
from gpdf_service.config import Config
from gpdf_service.errors import ConfigError
from gpdf_service.service.logs import MOST, WINDOW_S, JsonFormatter, Sparing, TextFormatter
from gpdf_service.service.options import Options, descriptions, gather, plain, to_toml
from gpdf_service.service.server import Server

FILE = """
[serve]
workers = 3
queue = 50
log_dir = "file"
connect = ["tcp/a:1", "tcp/b:2"]

[planning]
corner_room = 0.7
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "gpdf.toml"
    path.write_text(FILE)
    return path


def test_flags_win_over_the_environment_and_that_over_the_file(file):
    environment = {"GPDF_QUEUE": "60", "GPDF_LOG_DIR": "environment", "PATH": "/bin", "GPDF_CONFIG": "ignored"}
    options, config = gather(file, environment, {"log_dir": "flag", "workers": None})
    assert (options.workers, options.queue, options.log_dir) == (3, 60, Path("flag"))
    assert options.connect == ("tcp/a:1", "tcp/b:2")
    assert config.planning.corner_room == 0.7


def test_nothing_needs_to_be_set():
    assert gather(None, {}, {}) == (Options(), Config())


def test_what_is_printed_is_read_back_the_same(file, tmp_path):
    options, config = gather(
        file, {"GPDF_LOG_SYNC": "each", "GPDF_STATE_DIR": 'a "b" \\ ü'}, {"scene_memory_mb": "1e3"}
    )
    again = tmp_path / "again.toml"
    again.write_text(to_toml(plain(options, config)))
    assert gather(again, {}, {}) == (options, config)
    assert options.flush_s == 0.0


@pytest.mark.parametrize(
    ("text", "environment", "words"),
    [
        ("[serve]\nworker = 3", {}, "worker"),
        ("[serve]\nworkers = 0", {}, "workers"),
        ("[serve]\nworkers = 'many'", {}, "workers"),
        ("serve = 3", {}, "table"),
        ("[serve]\nrole = 'king'", {}, "role"),
        ("[serve]\nrole = 'planner'", {}, "--connect"),
        ("[planing]\nx = 1", {}, "planing"),
        ("[serve", {}, "TOML"),
        ("", {"GPDF_QUEUE": "1000"}, "queue"),
        ("", {"GPDF_LOG_SYNC": "sometimes"}, "log_sync"),
        ("", {"GPDF_LOGDIR": "x"}, "logdir"),
    ],
)
def test_a_wrong_value_is_an_error_with_its_name(tmp_path, text, environment, words):
    path = tmp_path / "gpdf.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        gather(path, environment, {})


@pytest.mark.parametrize("endpoint", ["tcp/[::]:7447", "tls/host:1", "unixsock-stream//tmp/gpdf.sock"])
def test_all_that_zenoh_can_listen_at_is_an_endpoint(endpoint):
    assert gather(None, {}, {"endpoint": endpoint})[0].endpoint == endpoint


def test_a_file_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(ConfigError, match="none"):
        gather(tmp_path / "none.toml", {}, {})


def test_every_option_is_described_and_has_a_flag(capsys):
    with pytest.raises(SystemExit):
        main(["serve", "--help"])
    text = capsys.readouterr().out
    for name, words in descriptions().items():
        assert words
        assert name == "role" or f"--{name.replace('_', '-')}" in text


def test_serve_prints_its_effective_configuration(file, capsys, monkeypatch):
    monkeypatch.setenv("GPDF_QUEUE", "60")
    monkeypatch.setenv("GPDF_CONFIG", str(file))
    assert main(["serve", "--print-config", "--workers", "7"]) == 0
    text = capsys.readouterr().out
    assert "queue = 60" in text
    assert "workers = 7" in text
    assert "corner_room = 0.7" in text


def test_a_wrong_option_ends_the_command_with_words(tmp_path):
    words = [sys.executable, "-m", "gpdf_service.cli", "serve", "--log-dir", str(tmp_path), "--queue", "0"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "queue" in done.stderr


def test_the_log_says_what_wrote_it(tmp_path, free_endpoint, office, office_file):
    shutil.copy(office_file, tmp_path / "office.gpdf")
    options = Options(free_endpoint, tmp_path, tmp_path / "log", 1, queue=77)
    with Server(options, [("office", tmp_path / "office.gpdf")]) as server:
        server.shelf._builder.submit(lambda: None).result(60)
    with server.recorder.path.open("rb") as file:
        found = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    assert json.loads(found["gpdf"]["config"])["serve"]["queue"] == 77
    assert json.loads(found["gpdf"]["config"])["planning"] == plain(options, Config())["planning"]
    assert "eclipse-zenoh" in json.loads(found["gpdf"]["versions"])
    assert json.loads(found["scene/office"]["facts"])["digest"] == office[1].digest


def record(**data):
    made = logging.LogRecord("gpdf", logging.WARNING, "f", 1, "scene %s", ("x",), None)
    vars(made).update(data)
    return made


def test_a_structured_message_is_one_json_object_with_its_data():
    line = json.loads(JsonFormatter().format(record(points=5, path=Path("a"))))
    assert (line["message"], line["level"], line["points"], line["path"]) == ("scene x", "WARNING", 5, "a")
    assert line["time"].endswith("Z")
    assert TextFormatter("%(message)s").format(record(points=5)) == "scene x points=5"


def test_messages_without_end_are_told_in_part_and_the_others_counted():
    now, told = [0.0], []
    sparing, handler = Sparing(lambda: now[0]), logging.Handler()
    handler.emit = lambda record: told.append(record.getMessage())
    handler.addFilter(sparing)
    log = logging.Logger("x")
    log.addHandler(handler)

    def complain(i):
        log.warning("message %d", i)

    for i in range(MOST + 7):
        complain(i)
    log.warning("another one")
    assert told == [*(f"message {i}" for i in range(MOST)), "another one"]
    now[0] = WINDOW_S
    complain(0)
    complain(1)
    assert told[-2:] == ["message 0 (and 7 more of these, which were not told)", "message 1"]
