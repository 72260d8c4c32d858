"""A body from the command line: one of the known ones, one from a file, with measures of one's own in place of its."""

from __future__ import annotations

import argparse
import dataclasses
import math
import tomllib
from pathlib import Path
from typing import Any

from gpdf_service.errors import ConfigError
from gpdf_service.types import AGENTS, Agent, resolve_agent

LIKE = "like"
"""Key of an agent file: the known body whose measures stand where the file says nothing."""
FLAGS = {
    "width": ("width", "of its footprint across its way [m]"),
    "length": ("length", "of its footprint along its way [m]"),
    "height": ("height", "of the body over the ground [m]"),
    "step": ("max_step", "highest step that it takes [m]"),
    "slope": ("max_slope", "steepest ground that it stands on [degrees]"),
}
"""Options, the measure that each stands for, and what they say."""


def add_body_arguments(parser: argparse.ArgumentParser, default: str | None = "human") -> None:
    """Declare who moves; for `body_of`."""
    group = parser.add_argument_group("the body")
    group.add_argument("--agent", default=default, help=f"{', '.join(AGENTS)}")
    group.add_argument("--agent-file", type=Path, help="a TOML file with the measures of a body of your own")
    for flag, (_, text) in FLAGS.items():
        group.add_argument(f"--{flag}", type=float, help=text)


def body_of(args: argparse.Namespace) -> Agent | None:
    """The body that the arguments name; None if they name none.

    Raises:
        ConfigError: the file cannot be read, or lacks a measure.
        RequestError: no such body, or one that cannot be planned for.
    """
    given = {name: getattr(args, flag) for flag, (name, _) in FLAGS.items() if getattr(args, flag) is not None}
    if "max_slope" in given:
        given["max_slope"] = math.radians(given["max_slope"])
    if args.agent_file is not None:
        body = read_agent(args.agent_file)
    elif (args.agent or "").endswith(".toml"):
        raise ConfigError(f"--agent {args.agent}", "that is the name of a file", f"Write --agent-file {args.agent}.")
    elif args.agent is not None or given:
        body = resolve_agent(args.agent or "human")
    else:
        return None
    if given:
        body = dataclasses.replace(body, name=body.name if args.agent_file else f"own {body.name}", **given)
    return resolve_agent(body)


def read_agent(path: Path) -> Agent:
    """A body from a TOML file: the fields of `Agent`, or `like` a known body and what is different.

    Raises:
        ConfigError: it is not there, is no TOML, has an unknown key, or lacks a measure.
        RequestError: a measure is out of range.
    """
    try:
        stored: dict[str, Any] = tomllib.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"agent file {path}", str(error), "Give a readable TOML file.") from error
    fields = {field.name: field for field in dataclasses.fields(Agent)}
    unknown = sorted(set(stored) - set(fields) - {LIKE})
    if unknown:
        raise ConfigError(f"agent file {path}", f"there is no key {unknown[0]!r}", f"Keys are {', '.join(fields)}.")
    made: dict[str, Any] = {"name": path.stem}
    if LIKE in stored:
        known = resolve_agent(stored.pop(LIKE))
        made = {name: getattr(known, name) for name in fields} | made
    made |= stored
    needed = [name for name, field in fields.items() if field.default is dataclasses.MISSING and name not in made]
    if needed:
        words = f'Say it, or `like = "human"` for what a known body has ({", ".join(AGENTS)}).'
        raise ConfigError(f"agent file {path}", f"it lacks {', '.join(needed)}", words)
    return resolve_agent(Agent(**made))
