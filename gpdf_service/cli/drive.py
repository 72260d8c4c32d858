"""`gpdf drive SCENE --goal x,y`: drive a robot, or a simulated one, along a planned trajectory."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from gpdf_client import Client, ClientError
from gpdf_client.cli import PLACE_HELP, add_connection, connect, named_place
from gpdf_robot import BODIES, Body, Drive, Driver, Errors, Pose, SimulatedRobot, State, drive_live, simulate
from gpdf_robot.driver import DELAY_S
from gpdf_robot.live import velocity_message
from gpdf_schemas import encode, keys

from gpdf_service.cli.inputs import check_there, is_file_name

PICTURE_CELL = 0.05
"""[m] Between samples of the distance in a picture."""
PICTURE_BORDER = 1.0
"""[m] Shown around the drive."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("scene", help="a scene of the service at --endpoint, or a cloud: then it serves that itself")
    parser.add_argument("--start", type=named_place, help=f"for --simulate: {PLACE_HELP}")
    parser.add_argument("--goal", type=named_place, required=True, help=PLACE_HELP)
    parser.add_argument("--agent", default="roomba", choices=BODIES, help="the robot's body")
    parser.add_argument("--name", default="robot", help=f"the robot's name: {keys.POSE}/NAME, {keys.VELOCITY}/NAME")
    parser.add_argument("--delay", type=float, default=DELAY_S, help="from a command to its effect [s]")
    add_connection(parser)
    parser.add_argument("--simulate", action="store_true", help="drive a simulated robot, in simulated time")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated robot's errors")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--png", type=Path, help="draw where it was planned and where it went (with --simulate)")


def run(args: argparse.Namespace) -> int:
    """Drive once; exit code 0 only if the robot arrived."""
    if args.simulate != (args.start is not None) or (args.png and not args.simulate):
        print("gpdf drive: --simulate needs --start; without it there is no --start and no --png", file=sys.stderr)
        return 2
    try:
        with _service(args) as scene, connect(args) as client:
            client.wait_for_scene(scene)
            args.goal = client.where(scene, args.goal)
            args.start = args.start and client.where(scene, args.start)
            result = (_simulated if args.simulate else _live)(client, scene, args)
    except ClientError as error:
        print(f"gpdf: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("gpdf: stopped", file=sys.stderr)
        return 130
    if args.json:
        print(json.dumps(result))
    else:
        for key, value in result.items():
            if key != "track" and value != "":
                print(f"{key}: {value:.3f}" if isinstance(value, float) else f"{key}: {value}")
    return 0 if result["state"] == State.ARRIVED.value else 1


@contextmanager
def _service(args: argparse.Namespace) -> Iterator[str]:
    """Name of the scene; where it is a file, in a service of its own, which the arguments then name."""
    cloud = Path(args.scene)
    if not cloud.is_file():
        if is_file_name(args.scene):
            check_there(cloud)
        yield args.scene
        return
    from tempfile import TemporaryDirectory

    from gpdf_service.ports import free_endpoint
    from gpdf_service.service.server import Options, Server  # the light install has none

    args.endpoint, args.zenoh = free_endpoint(), None
    with TemporaryDirectory() as log:
        options = Options(args.endpoint, Path(log), Path(log), workers=1)  # one asks, one thing at a time
        with Server(options, [("scene", cloud)]):
            yield "scene"


def _live(client: Client, scene: str, args: argparse.Namespace) -> dict[str, Any]:
    driver = Driver(client, scene, args.goal, BODIES[args.agent], delay_s=args.delay)
    told = ""

    def tell(driver: Driver) -> None:
        nonlocal told
        words = f"{driver.state}: {driver.reason}" if driver.reason else str(driver.state)
        if words.split(":")[0] != told.split(":")[0]:
            print(words, file=sys.stderr)
        told = words

    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())  # the last commands are to stand, as after Ctrl-C
    drive_live(driver, client.session, args.name, stop=stop, on_step=tell)
    return {"state": driver.state.value, "reason": driver.reason, "plans": driver.plans}


def _simulated(client: Client, scene: str, args: argparse.Namespace) -> dict[str, Any]:
    body, rng = BODIES[args.agent], np.random.default_rng(args.seed)
    start_z = args.start[2] if len(args.start) == 3 else None
    pose = Pose(args.start[0], args.start[1], float(rng.uniform(-np.pi, np.pi)))
    robot = SimulatedRobot(body, pose, Errors(command_s=args.delay), rng)
    driver = Driver(client, scene, args.goal, body, delay_s=args.delay)
    publisher = client.session.declare_publisher(f"{keys.VELOCITY}/{args.name}")
    drive = simulate(
        driver,
        robot,
        start_z=start_z,
        on_step=lambda robot, command: publisher.put(
            encode(velocity_message(command, robot.pose.stamp, driver.state.value))
        ),
    )
    if args.png:
        _draw(client, scene, body, drive, args)
    return summary(drive, args.goal) | {"track": drive.track[::10].round(4).tolist()}


def summary(drive: Drive, goal: tuple[float, ...]) -> dict[str, Any]:
    """The numbers of a drive."""
    return {
        "state": drive.state.value,
        "reason": drive.reason,
        "seconds": drive.seconds,
        "driven_m": float(np.hypot(*np.diff(drive.track, axis=0).T).sum()),
        "plans": drive.plans,
        "stops": drive.stops,
        "error_p95_m": drive.error_p95,
        "goal_error_m": float(np.hypot(*(drive.track[-1] - np.array(goal[:2])))),
    }


def _draw(client: Client, scene: str, body: Body, drive: Drive, args: argparse.Namespace) -> None:
    from gpdf_service.viewer.drive_picture import draw_drive  # needs matplotlib

    lines = [path.ground for path in drive.planned]
    shown = np.vstack([drive.track, *(line[:, :2] for line in lines)])
    low, high = shown.min(axis=0) - PICTURE_BORDER, shown.max(axis=0) + PICTURE_BORDER
    x, y = (np.arange(a, b, PICTURE_CELL) for a, b in zip(low, high, strict=True))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    found = client.distance(scene, "obstacle", places, args.agent)
    distance = np.where(found.valid, found.distance, np.nan).reshape(len(x), len(y))
    title = f"{args.agent}: {drive.state}, 95 % of the way within {100 * drive.error_p95:.1f} cm of the line"
    draw_drive(args.png, (x, y, distance), lines, drive.track, body.radius, title=title)
