"""`gpdf guide SCENE --goal x,y`: lead a person by poses over Zenoh, or a simulated one with `--simulate`.

Runs with the light install; `--truth` and `--png` need the server's.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
from gpdf_client import Client, ClientError
from gpdf_client.cli import PLACE_HELP, add_connection, connect, named_place
from gpdf_guidance import LANGUAGES, PERSON, Guide, Outcome, Planner, Walk, Walker, simulate
from gpdf_guidance.instruction import Instruction
from gpdf_guidance.live import LiveGuide, Told, to_json
from gpdf_guidance.voice import Voice
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("scene", help="name of a scene of the service")
    parser.add_argument("--goal", type=named_place, required=True, help=PLACE_HELP)
    add_connection(parser)
    parser.add_argument("--name", default="person", help="poses come on gpdf/v1/pose/NAME, cues go to gpdf/v1/cue/NAME")
    parser.add_argument(
        "--width", type=float, default=PERSON["width"], help="of the person, elbows and bag included [m]"
    )
    parser.add_argument("--height", type=float, default=PERSON["height"], help="of the person with a hat [m]")
    parser.add_argument("--language", choices=LANGUAGES, default="en")
    parser.add_argument("--unit", choices=["metres", "steps"], default="metres", help="of distances")
    parser.add_argument("--speak", action="store_true", help="speak through espeak-ng")
    parser.add_argument("--json", action="store_true", help="print sentences and the result as lines of JSON")
    walk = parser.add_argument_group("a simulated person, with over-turns, delay, drift and a sensor that drops out")
    walk.add_argument("--simulate", action="store_true", help="no poses are awaited: a simulated person walks")
    walk.add_argument("--start", type=named_place, help=f"where it stands: {PLACE_HELP}")
    walk.add_argument("--seed", type=int, default=0, help="of its errors")
    walk.add_argument("--truth", help="a synthetic scene's name or a cloud: contacts with its points are counted")
    walk.add_argument("--png", type=Path, help="draw the walked path beside the planned one; needs --truth")


def run(args: argparse.Namespace) -> int:
    """Guide; exit code 0 only on arrival, without a contact."""
    if args.simulate and args.start is None:
        print("gpdf guide: --simulate needs --start x,y", file=sys.stderr)
        return 2
    if (args.truth and not args.simulate) or (args.png and not args.truth):
        print("gpdf guide: --png needs --truth, and both go with --simulate", file=sys.stderr)
        return 2
    try:
        voice = Voice(args.language) if args.speak else None
        with connect(args) as client:
            client.info(args.scene)  # a scene that is not there is said at once
            planner = Planner(client, args.scene, {**PERSON, "width": args.width, "height": args.height})
            guide = Guide(planner, client.where(args.scene, args.goal), args.language, args.unit)
            return (
                _simulated(args, client, guide)
                if args.simulate
                else _live(args, LiveGuide(client.session, guide, args.name, _told(args, voice)), guide)
            )
    except (ClientError, FileNotFoundError) as error:
        print(f"gpdf guide: {error}", file=sys.stderr)
        return 1


def _live(args: argparse.Namespace, live: LiveGuide, guide: Guide) -> int:
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    outcome = live.run(stop.is_set)
    _result(args, {"outcome": outcome.value, "reason": guide.reason})
    return 0 if outcome is Outcome.ARRIVED else 1


def _told(args: argparse.Namespace, voice: Voice | None) -> Told:
    def told(time_s: float, instruction: Instruction, text: str) -> None:
        _print(args, time_s, instruction, text)
        if voice is not None:
            voice.say(text)

    return told


def _simulated(args: argparse.Namespace, client: Client, guide: Guide) -> int:
    first = client.plan(args.scene, args.start, args.goal, guide.planner.person)
    if first.trajectory is None:
        print(f"gpdf guide: {first.status}: {first.message}", file=sys.stderr)
        return 1
    rng = np.random.default_rng(args.seed)
    world = _truth(args.truth, guide.planner.person) if args.truth else None
    ground = world.ground_height if world is not None else lambda position: _route_height(guide, position)
    walker = Walker(first.trajectory.ground[0], float(rng.uniform(-np.pi, np.pi)), ground, rng)
    walk = simulate(guide, walker, world)
    for said in walk.said:
        _print(args, said.time, said.instruction, said.text)
    if args.png and world is not None:
        from gpdf_service.viewer.walk import draw_walk

        draw_walk(args.png, walk, guide.routes, world.judge.other, f"{args.scene}: guided walk, seed {args.seed}")
    contact = None if world is None else bool(walk.penetration > 0)
    _result(args, _facts(walk, contact))
    return 0 if walk.outcome is Outcome.ARRIVED and not contact else 1


def _truth(name: str, person: dict[str, Any]) -> Any:  # noqa: ANN401 - imported only here
    from gpdf_service.bench.report import read_scene
    from gpdf_service.bench.walks import WalkedWorld
    from gpdf_service.perception import segment_ground
    from gpdf_service.types import Agent

    _, points, ground = read_scene(name)
    return WalkedWorld.of(points, segment_ground(points) if ground is None else ground, Agent(**person))


def _route_height(guide: Guide, position: FloatArray) -> float:
    """Height of the planned ground that is nearest, where no truth is given."""
    if guide.route is None:
        return float(position[2])
    ground = guide.route.ground
    return float(ground[int(((ground - position) ** 2).sum(axis=1).argmin()), 2])


def _facts(walk: Walk, contact: bool | None) -> dict[str, Any]:
    return {
        "outcome": walk.outcome.value,
        "reason": walk.reason,
        "seconds": round(float(walk.times[-1]), 2),
        "metres": round(walk.metres, 2),
        "said": len(walk.said),
        "said_per_min": round(walk.per_minute, 2),
        "routes": walk.routes,
        "contact": contact,
    }


def _print(args: argparse.Namespace, time_s: float, instruction: Instruction, text: str) -> None:
    line = json.dumps(to_json(time_s, instruction, text)) if args.json else f"{time_s:6.1f} s  {text}"
    print(line, flush=True)


def _result(args: argparse.Namespace, facts: dict[str, Any]) -> None:
    print(
        json.dumps(facts) if args.json else ", ".join(f"{key} {value}" for key, value in facts.items() if value != "")
    )
