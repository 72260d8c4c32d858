"""`gpdf guide SCENE --goal x,y`: lead a person by poses over Zenoh, or a simulated one with `--simulate`.

Runs with the light install; `--truth` and `--png` need the server's.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gpdf_client import Client, ClientError
from gpdf_client.cli import PLACE_HELP, add_connection, connect, named_place
from gpdf_guidance import LANGUAGES, PERSON, Detail, Guide, Manner, Outcome, Planner, Walk, Walker, simulate
from gpdf_guidance.alignment import DRIFT
from gpdf_guidance.instruction import Instruction
from gpdf_guidance.live import LiveGuide, Told, to_json
from gpdf_guidance.voice import Voice
from numpy.typing import NDArray

from gpdf_service.cli.work import Work

FloatArray = NDArray[np.float64]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("scene", help="name of a scene of the service")
    parser.add_argument("--goal", type=named_place, required=True, help=PLACE_HELP)
    add_connection(parser)
    parser.add_argument("--name", default="person", help="of the streams pose, ask, cue and say: gpdf/v1/pose/NAME …")
    parser.add_argument(
        "--width", type=float, default=PERSON["width"], help="of the person, elbows and bag included [m]"
    )
    parser.add_argument("--height", type=float, default=PERSON["height"], help="of the person with a hat [m]")
    parser.add_argument(
        "--language", choices=LANGUAGES, default="en", help="of the sentences; %(default)s if not given"
    )
    parser.add_argument("--unit", choices=["metres", "steps"], default="metres", help="of distances")
    parser.add_argument("--words", choices=["few", "normal", "many"], default="normal", help="how much is said")
    parser.add_argument("--clock", action="store_true", help="tell turns by the face of a clock")
    parser.add_argument("--speak", action="store_true", help="speak through espeak-ng")
    parser.add_argument("--json", action="store_true", help="print sentences and the result as lines of JSON")
    phone = parser.add_argument_group("a phone's browser as eyes, voice and buttons")
    phone.add_argument("--phone", action="store_true", help="serve a page that sends poses and speaks; extra: phone")
    phone.add_argument("--phone-host", default="0.0.0.0", help="address to listen at")
    phone.add_argument("--phone-port", type=int, default=8443, help="port to listen at; 0 for any")
    phone.add_argument("--drift", type=float, default=DRIFT, help="metres that the phone's tracking loses in a metre")
    walk = parser.add_argument_group("a simulated person, with over-turns, delay, drift and a sensor that drops out")
    walk.add_argument("--simulate", action="store_true", help="no poses are awaited: a simulated person walks")
    walk.add_argument("--start", type=named_place, help=f"where it stands: {PLACE_HELP}")
    walk.add_argument("--seed", type=int, default=0, help="of its errors")
    walk.add_argument("--agrees", action="store_true", help="it says yes to a step of more than 0.2 m; else no")
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
            guide = Guide(planner, client.where(args.scene, args.goal), name=_name(args.goal), manner=_manner(args))
            if args.simulate:
                return _simulated(args, client, guide)
            live = LiveGuide(client.session, guide, args.name, _told(args, voice))
            return _by_phone(args, client, live) if args.phone else _live(args, live, guide)
    except (ClientError, FileNotFoundError) as error:
        print(f"gpdf guide: {error}", file=sys.stderr)
        return 1


def _by_phone(args: argparse.Namespace, client: Client, live: LiveGuide) -> int:
    """Guide by a page in a phone's browser until the program is stopped: after one goal there may be another."""
    from gpdf_guidance.phone import Phone, PhoneServer, qr_code

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    places = partial(client.places, args.scene)
    phone = Phone(client.session, args.name, places, _name(args.goal), args.language, args.drift)
    with PhoneServer(phone, Path.home() / ".config" / "gpdf", args.phone_host, args.phone_port) as server:
        if not args.json:
            print(qr_code(server.url))
        print(json.dumps({"url": server.url}) if args.json else f"Open {server.url} on the phone.", flush=True)
        live.run(stop.is_set, stays=True)
    return 0


def _manner(args: argparse.Namespace) -> Manner:
    return Manner(args.language, args.unit, Detail[args.words.upper()], args.clock)


def _name(goal: object) -> str:
    """What the person calls the goal; positions have no name."""
    return goal if isinstance(goal, str) else ""


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
    with Work("walk", load=None) as work, work.step("walk"):
        walk = simulate(guide, walker, world, agrees=args.agrees)
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

    _, points, ground, _ = read_scene(name)
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
        "from_goal": round(walk.end, 2),
        "contact": contact,
    }


def _print(args: argparse.Namespace, time_s: float, instruction: Instruction, text: str) -> None:
    line = json.dumps(to_json(time_s, instruction, text)) if args.json else f"{time_s:6.1f} s  {text}"
    print(line, flush=True)


def _result(args: argparse.Namespace, facts: dict[str, Any]) -> None:
    print(
        json.dumps(facts) if args.json else ", ".join(f"{key} {value}" for key, value in facts.items() if value != "")
    )
