"""How to serve: a TOML file, then the environment, then flags; the later wins. `--print-config` shows the result."""

from __future__ import annotations

import dataclasses
import json
import re
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import psutil
from msgspec import Meta

from gpdf_service.config import SERVICE_TABLE, Config, read_tables
from gpdf_service.cores import worker_count
from gpdf_service.errors import ConfigError
from gpdf_service.types import resolve_agent

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
ENVIRONMENT = "GPDF_"
"""What the name of an option starts with in the environment: GPDF_LOG_DIR, GPDF_WORKERS, …"""

HALF_OF_MEMORY_MB = round(0.5e-6 * psutil.virtual_memory().total)
"""[MB] What one build may take: the other half is for the scenes, the plans and everybody else."""

ENDPOINT = re.compile(r"[\w-]+/.")
"""How Zenoh's endpoints begin: a protocol and an address."""

Count = Annotated[int, Meta(ge=1)]
Amount = Annotated[float, Meta(gt=0)]


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How to serve; each field's description is the help of its flag."""

    endpoint: Annotated[str, Meta(description="where to listen; empty: only connect")] = DEFAULT_ENDPOINT
    scenes_dir: Annotated[Path, Meta(description="folder of the files that clients may load")] = Path("scenes")
    log_dir: Annotated[Path, Meta(description="folder for the logs")] = Path("log")
    workers: Annotated[Count, Meta(description="processes that plan; with 1, the service's own does")] = worker_count()
    role: Annotated[Literal["both", "map", "planner"], Meta(description="which of the two services to run")] = "both"
    connect: Annotated[tuple[str, ...], Meta(description="routers to join, with commas between")] = ()
    zenoh: Annotated[Path | None, Meta(description="Zenoh configuration (JSON5) with credentials and rights")] = None
    state_dir: Annotated[
        Path | None,
        Meta(description="folder of ready scenes; LOG_DIR/state if not given, of a planner LOG_DIR/planner"),
    ] = None
    queue: Annotated[Count, Meta(description="requests that may wait; beyond, the answer is BUSY", le=200)] = 128
    scene_memory_mb: Annotated[Amount, Meta(description="memory of all scenes; the least used leave it first")] = 4096.0
    build_memory_mb: Annotated[Amount, Meta(description="memory that a build may take; half of the machine's")] = (
        HALF_OF_MEMORY_MB
    )
    bodies: Annotated[
        tuple[str, ...], Meta(description="whose free spaces are built with each scene, with commas between")
    ] = ("human",)
    log_sync: Annotated[
        str, Meta(description="seconds between flushes of the log, or 'each'", pattern=r"^(each|\d+(\.\d+)?)$")
    ] = "0.5"
    log_segment_mb: Annotated[Amount, Meta(description="size of a log at which the next begins")] = 256.0
    log_segment_s: Annotated[Amount, Meta(description="age of a log at which the next begins")] = 86_400.0
    log_keep_mb: Annotated[Amount, Meta(description="size of all logs beyond which the oldest is deleted")] = 20_000.0
    log_keep_days: Annotated[Amount, Meta(description="age beyond which a log is deleted")] = 90.0
    log_spare_hours: Annotated[
        float, Meta(description="age below which a log is never deleted for its size; then hashes are recorded", ge=0)
    ] = 24.0
    log_min_free_mb: Annotated[Amount, Meta(description="room on the disk below which nothing is recorded")] = 200.0
    metrics_port: Annotated[int, Meta(description="port of this machine for Prometheus; 0: none", ge=0, le=65_535)] = 0
    log_format: Annotated[Literal["text", "json"], Meta(description="how the messages on stderr look")] = "text"

    @property
    def state(self) -> Path:
        """Folder of ready scenes."""
        return self.state_dir or self.log_dir / ("planner" if self.role == "planner" else "state")

    @property
    def processes(self) -> int:
        """Processes that plan, beside the service's own."""
        return self.workers if self.workers > 1 and self.role != "map" else 0

    @property
    def memory_bytes(self) -> float:
        """Of scenes in each process: the service's own, the one that builds, those that plan."""
        return 1e6 * self.scene_memory_mb / (2 + self.processes)

    @property
    def spare_bytes(self) -> float:
        """That scenes leave free on the disk: twice what the log does, so that they never stop it."""
        return 2e6 * self.log_min_free_mb

    @property
    def flush_s(self) -> float:
        """Seconds between flushes of the log; 0: after each message, before its reply is sent."""
        return 0.0 if self.log_sync == "each" else float(self.log_sync)


def descriptions() -> dict[str, str]:
    """What each option means."""
    hints = typing.get_type_hints(Options, include_extras=True)
    return {name: _described(hints[name]) for name in Options.__struct_fields__}


def gather(file: Path | None, environment: Mapping[str, str], flags: Mapping[str, object]) -> tuple[Options, Config]:
    """The effective options and settings.

    Args:
        file: A TOML file; its table `serve` holds options, the others are the settings of `gpdf_service.config`.
        environment: Variables of the process; only those that begin with `ENVIRONMENT` are read.
        flags: Options of the command line; None where one was not given.

    Raises:
        ConfigError: an unknown key, a wrong type or a value out of range; the file is not there or no TOML.
    """
    tables = {} if file is None else read_tables(file)
    given = tables.pop(SERVICE_TABLE, {})
    if not isinstance(given, dict):
        raise ConfigError(SERVICE_TABLE, f"{given!r}", "It must be a table of keys and values.")
    named = {name.removeprefix(ENVIRONMENT).lower(): text for name, text in environment.items() if _ours(name)}
    values = given | named | {name: value for name, value in flags.items() if value is not None}
    for name in ("connect", "bodies"):
        if isinstance(values.get(name), str):
            values[name] = [part.strip() for part in values[name].split(",") if part.strip()]
    try:
        options = msgspec.convert(values, Options, strict=False, dec_hook=lambda kind, value: kind(value))
    except (msgspec.ValidationError, TypeError) as error:
        raise ConfigError(SERVICE_TABLE, str(error), f"Options: {', '.join(Options.__struct_fields__)}.") from error
    for endpoint in filter(None, (options.endpoint, *options.connect)):
        if not ENDPOINT.match(endpoint):
            raise ConfigError(SERVICE_TABLE, f"{endpoint!r} is no endpoint", "Write tcp/HOST:PORT, or tls/HOST:PORT.")
    for body in options.bodies:
        resolve_agent(body)
    if options.role == "planner" and not options.connect:
        raise ConfigError("serve.connect", "a planner without a map service", "Say where it is: --connect ENDPOINT.")
    return options, Config.from_mapping(tables)


def plain(options: Options, config: Config) -> dict[str, Any]:
    """Both as nested mappings, ready for JSON or TOML; what is not set is left out."""
    made = msgspec.to_builtins(options, enc_hook=str)
    return {
        SERVICE_TABLE: {name: value for name, value in made.items() if value is not None},
        **dataclasses.asdict(config),
    }


def to_toml(values: Mapping[str, Mapping[str, Any]]) -> str:
    """A file that `gather` reads back; numbers, truths, lists and texts look in TOML as they do in JSON."""
    tables = (
        (name, (f"{key} = {json.dumps(value)}" for key, value in table.items())) for name, table in values.items()
    )
    return "\n\n".join(f"[{name}]\n" + "\n".join(lines) for name, lines in tables)


def _ours(name: str) -> bool:
    return name.startswith(ENVIRONMENT) and name != f"{ENVIRONMENT}CONFIG"


def _described(hint: Any) -> str:  # noqa: ANN401 - a type with annotations
    found = [note.description for note in getattr(hint, "__metadata__", ()) if isinstance(note, Meta)]
    return next(text for text in reversed(found) if text)
