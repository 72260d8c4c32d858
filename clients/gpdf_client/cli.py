"""`gpdf client …`: ask a running service from the command line; needs only the light install."""

from __future__ import annotations

import argparse
import json
import math
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import zenoh

from gpdf_client.client import DEFAULT_ENDPOINT, Client
from gpdf_client.results import ClientError, PlanResult, UnavailableError

FACTS = ("state", "version", "points", "levels", "noise", "agents_ready")
"""Of each scene, for people; `--json` has all."""
TELL_S = 1.0
"""[s] Who waits longer for a service is told so."""
SCENE_HELP = "name of a scene of the service"
BODY_HELP = "roomba, spot, pepper or human"
ALTERNATIVES_HELP = "so many more paths that differ, as far as there are any"
PLACE_HELP = "a named place, or x,y or x,y,z of the ground there [m]"


def add_connection(parser: argparse.ArgumentParser, endpoint: str = DEFAULT_ENDPOINT, zenoh: str | None = None) -> None:
    """Declare where the service is, for `connect`."""
    parser.add_argument(
        "--endpoint", default=endpoint, help=f"the service: {DEFAULT_ENDPOINT} if not given (GPDF_ENDPOINT)"
    )
    words = "a Zenoh configuration (JSON5) with credentials; it names the endpoint, too"
    parser.add_argument("--zenoh", default=zenoh, help=words)


def read_credentials(args: argparse.Namespace) -> zenoh.Config | None:
    """The configuration that the arguments name, if any.

    Raises:
        ClientError: it cannot be read.
    """
    try:
        return zenoh.Config.from_file(args.zenoh) if args.zenoh else None
    except zenoh.ZError as error:
        raise UnavailableError(f"{args.zenoh} is no Zenoh configuration ({error}).") from error


def connect(args: argparse.Namespace) -> Client:
    """A connection to the service that the arguments name.

    Raises:
        ClientError: nothing answers there, or the configuration cannot be read.
    """
    config, words = read_credentials(args), f"gpdf: looking for a service at {args.endpoint} …"
    tell = threading.Timer(TELL_S, lambda: print(words, file=sys.stderr))
    tell.start()
    try:
        return Client.connect(args.endpoint, config=config)
    finally:
        tell.cancel()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    add_connection(parser)
    verbs = parser.add_subparsers(dest="verb", required=True)

    def verb(name: str, text: str, act: Callable[[Client, argparse.Namespace], Any]) -> argparse.ArgumentParser:
        made: argparse.ArgumentParser = verbs.add_parser(name, help=text, description=text)
        made.add_argument("--json", action="store_true", help="print the result as JSON")
        add_connection(made, argparse.SUPPRESS, argparse.SUPPRESS)  # said behind the sub-verb, it counts as well
        made.set_defaults(act=act)
        return made

    verb("scenes", "list the scenes", lambda client, _: client.scenes())
    verb("status", "health, readiness and metrics of every service", lambda client, _: _status(client))
    for name, text, act in (
        ("info", "facts of a scene", lambda client, args: client.info(args.scene)),
        ("unload", "let the service forget a scene", lambda client, args: client.unload_scene(args.scene)),
    ):
        verb(name, text, act).add_argument("scene", help=SCENE_HELP)
    load = verb("load", "load a file of the service's scenes folder", lambda c, a: c.load_scene(a.scene, a.file))
    load.add_argument("scene", help="the name that it gets")
    load.add_argument("file", help="in that folder: a cloud or a scene (.gpdf)")
    named = verb("place", "list the named places of a scene, name one, or remove one", _place)
    named.add_argument("scene", help=SCENE_HELP)
    named.add_argument("name", nargs="?", help="of the place; all are listed if not given")
    named.add_argument("--at", type=place, help="where it is: x,y or x,y,z of the ground there [m]")
    named.add_argument("--remove", action="store_true", help="forget it")
    plan = verb("plan", "plan a trajectory", _plan)
    plan.add_argument("scene", help=SCENE_HELP)
    plan.add_argument("--start", required=True, type=named_place, help=PLACE_HELP)
    plan.add_argument("--goal", required=True, type=named_place, help=PLACE_HELP)
    plan.add_argument("--agent", default="human", help=BODY_HELP)
    plan.add_argument("--method", default="dual_gpdf", help="dual_gpdf, or a baseline: single_gpdf, astar, prm")
    plan.add_argument(
        "--via",
        action="append",
        default=[],
        type=named_place,
        help="go through a place, named or x,y or x,y,z [m]; repeatable",
    )
    plan.add_argument(
        "--or-goal",
        action="append",
        default=[],
        type=named_place,
        help="one more goal, named or x,y or x,y,z [m]; the nearest is taken",
    )
    plan.add_argument("--snap", type=float, default=0.0, help="move a place that is not valid by this much at most [m]")
    plan.add_argument(
        "--prefer", choices=["quickest", "level", "wide"], help="not given: as a sighted companion would lead"
    )
    plan.add_argument("--alternatives", type=int, default=0, help=ALTERNATIVES_HELP)
    plan.add_argument("--save", type=Path, help="write the trajectory to a .json, .csv or .geojson file")
    distance = verb("distance", "distance to the ground or to the obstacles", _distance)
    distance.add_argument("scene", help=SCENE_HELP)
    distance.add_argument("field", choices=["ground", "obstacle"], help="to the ground, or to what stops a body")
    distance.add_argument("--at", required=True, type=place, help="x,y or x,y,z [m]")
    distance.add_argument("--agent", default="human", help=BODY_HELP)


def run(args: argparse.Namespace) -> int:
    """Ask; exit code 0 only if the service did what was asked."""
    try:
        with connect(args) as client:
            result = args.act(client, args)
    except (ClientError, OSError, ValueError) as error:
        print(f"gpdf: {error}", file=sys.stderr)
        return 1
    if args.json:
        print(json.dumps(result))
    elif args.verb == "place":
        for name, position in result["places"].items():
            print(f"{name}: {','.join(map(str, position))}")
    elif args.verb == "status":
        print("\n".join(map(_line, result["services"])) or "no service answers")
    elif args.verb == "scenes":
        print("\n".join(table(result)) or "no scenes")
    elif isinstance(result, dict):
        for key, value in result.items():
            print(f"{key}: {told(value)}")
    return 1 if isinstance(result, dict) and result.get("status", "OK") != "OK" else 0


def told(value: Any) -> str:  # noqa: ANN401 - whatever a reply holds
    """A fact for people: numbers to four digits."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {told(each)}" for key, each in value.items())
    if isinstance(value, list | tuple):
        return (
            "; ".join(map(told, value)) if any(isinstance(each, dict) for each in value) else " ".join(map(told, value))
        )
    return str(value)


def table(facts: dict[str, dict[str, Any]], keys: tuple[str, ...] = FACTS) -> list[str]:
    """A line a scene under a line of the names of the facts; of lists, how many there are."""
    rows = [["scene", *(key.replace("_", " ") for key in keys)]] if facts else []
    for name, each in facts.items():
        cells = [each.get(key, "") for key in keys]
        rows.append([name, *(str(len(cell)) if isinstance(cell, list | dict) else told(cell) for cell in cells)])
    widths = [max(len(row[i]) for row in rows) for i in range(len(keys) + 1)] if rows else []
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _status(client: Client) -> dict[str, Any]:
    services = [msgspec.to_builtins(reply) for reply in client.status()]
    healthy = bool(services) and all(service["healthy"] for service in services)
    ready = healthy and all(service["ready"] for service in services)
    return {"status": "OK" if ready else "BUILDING" if healthy else "UNAVAILABLE", "services": services}


def _line(service: dict[str, Any]) -> str:
    """How a service is, for people."""
    numbers = service["metrics"]
    state = "not healthy" if not service["healthy"] else "ready" if service["ready"] else "not ready yet"
    answers = (f"{name.removeprefix('answers_')} {n:.0f}" for name, n in numbers.items() if name.startswith("answers_"))
    facts = (
        f"{service['role']} {service['planner']}: {state}",
        f"load {service['load']:.1f}",
        f"{numbers['scenes']:.0f} scenes",
        f"{numbers['memory_bytes'] / 1e6:.0f} MB",
        f"half within {1000 * numbers['answer_p50_s']:.1f} ms",
        f"answers {' '.join(answers) or 'none'}",
    )
    return "\n  ".join([", ".join(facts), *service["problems"]])


def _plan(client: Client, args: argparse.Namespace) -> dict[str, Any]:
    options = {"method": args.method, "via": args.via, "other_goals": args.or_goal, "snap": args.snap}
    options |= {"prefer": args.prefer, "alternatives": args.alternatives}
    result = client.plan(args.scene, args.start, args.goal, args.agent, **options)
    made: dict[str, Any] = {"status": str(result.status), "message": result.message, **_facts(result)}
    if result.alternatives:
        made["alternatives"] = [_facts(other) for other in result.alternatives]
    if result.trajectory is not None:
        if args.save is not None:
            result.trajectory.save(args.save)
        if args.json:
            made["positions"] = result.trajectory.positions.tolist()
    return made


def _facts(result: PlanResult) -> dict[str, float]:
    """What one asks of a way."""
    if result.trajectory is None or result.certificate is None:
        return {}
    return {
        "length": result.trajectory.length,
        "duration": result.trajectory.duration,
        "min_clearance": result.certificate.min_clearance,
        "steps": result.details.get("steps", 0.0),
        "highest_step": result.certificate.max_step,
    }


def _place(client: Client, args: argparse.Namespace) -> dict[str, Any]:
    if (args.name is None) == (args.remove or args.at is not None) or (args.remove and args.at is not None):
        raise ValueError("place SCENE lists, place SCENE NAME --at x,y sets, place SCENE NAME --remove removes")
    if args.name is None:
        return {"places": client.places(args.scene)}
    if args.remove:
        return {"places": client.remove_place(args.scene, args.name)}
    return {"places": client.set_place(args.scene, args.name, args.at)}


def _distance(client: Client, args: argparse.Namespace) -> dict[str, Any]:
    found = client.distance(args.scene, args.field, np.array([args.at]), args.agent)
    return {"distance": float(found.distance[0]), "valid": bool(found.valid[0])}


def named_place(text: str) -> str | tuple[float, ...]:
    """Parse `x,y`, `x,y,z` or the name of a place, which has no comma."""
    return place(text) if "," in text else text


def place(text: str) -> tuple[float, ...]:
    """Parse `x,y` or `x,y,z`."""
    try:
        parts = tuple(float(part) for part in text.split(","))
    except ValueError:
        parts = ()
    if len(parts) not in (2, 3) or not all(map(math.isfinite, parts)):
        raise argparse.ArgumentTypeError(f"{text!r} is no place: write x,y or x,y,z in metres")
    return parts
