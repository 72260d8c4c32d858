"""`gpdf plan INPUT --start x,y --goal x,y`: build or load a scene and plan in it, without a service."""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from gpdf_client.cli import ALTERNATIVES_HELP, place

from gpdf_service.cli.bodies import add_body_arguments, body_of
from gpdf_service.cli.inputs import add_cloud_arguments, check_in, check_out, open_scene, positive
from gpdf_service.cli.work import Work
from gpdf_service.types import Agent, Method, PlanResult, Preference, Status

if TYPE_CHECKING:
    from gpdf_service.scene import Scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_cloud_arguments(parser)
    parser.add_argument("--start", type=place, required=True, help="x,y or x,y,z of the ground there [m]")
    parser.add_argument("--goal", type=place, required=True, help="x,y or x,y,z of the ground there [m]")
    add_body_arguments(parser)
    parser.add_argument("--discs", type=int, help="discs along the body that stand for it; 1 is its upright cylinder")
    parser.add_argument(
        "--method", default="dual_gpdf", choices=get_args(Method), help="ours, or one of the paper's baselines"
    )
    parser.add_argument(
        "--via", action="append", default=[], type=place, help="go through x,y or x,y,z [m]; repeatable"
    )
    parser.add_argument(
        "--or-goal", action="append", default=[], type=place, help="one more goal; the nearest is taken"
    )
    parser.add_argument(
        "--snap", type=float, default=0.0, help="move a place that is not valid by this much at most [m]"
    )
    parser.add_argument("--prefer", choices=get_args(Preference), help="not given: as a sighted companion would lead")
    parser.add_argument("--alternatives", type=int, default=0, help=ALTERNATIVES_HELP)
    parser.add_argument("--deadline", type=positive, help="seconds that the plan may take")
    parser.add_argument("--png", type=Path, help="draw the cloud, the field and the path")
    parser.add_argument("--json", action="store_true", help="print the result as JSON, with the trajectory")


def run(args: argparse.Namespace) -> int:
    """Plan once; exit code 0 only for a certified trajectory."""
    agent = body_of(args)
    assert agent is not None  # a body is named by default
    if args.discs is not None:
        agent = dataclasses.replace(agent, discs=args.discs)
    if args.png:
        check_out(args.png, "--png")
    check_in(args)
    scene, result, seconds = _plan(args, agent)
    if args.json:
        print(json.dumps(to_json(result)))
    else:
        print(f"{result.status}: {result.message}" if result.message else f"{result.status}")
        if result.trajectory is not None and result.certificate is not None:
            print(f"{_words(result)}, planned in {1000 * seconds:.0f} ms")
            for other in result.alternatives:
                print(f"or {_words(other)}")
            if scene.noise > 0.0 and not scene.labelled:
                hidden = 100 * result.certificate.hidden_height
                print(
                    f"the cloud is noisy: what is no higher than {hidden:.0f} cm over the ground may be missing from it"
                )
    return 0 if result.status is Status.OK else 1


def _plan(args: argparse.Namespace, agent: Agent) -> tuple[Scene, PlanResult, float]:
    """The scene, the answer, and how long that took with what the body needs first [s]; drawn if that was asked."""
    with Work("read", "build", "fit", *["draw"] * bool(args.png)) as work:
        from gpdf_service.pipeline import plan

        scene = open_scene(args.input, args, work)
        options = {"via": args.via, "other_goals": args.or_goal, "snap": args.snap, "deadline_s": args.deadline}
        options |= {"prefer": args.prefer, "alternatives": args.alternatives}
        began = time.perf_counter()
        with work.step("fit"):
            result = plan(scene, args.start, args.goal, agent, method=args.method, **options)
        seconds = time.perf_counter() - began
        if args.png:
            with work.step("draw"):
                from gpdf_service.viewer.picture import draw_plans

                shown = {agent.name: result} | {f"way {n}": way for n, way in enumerate(result.alternatives, start=2)}
                draw_plans(scene, shown, args.png, agent=agent, start=args.start, goal=args.goal)
    return scene, result, seconds


def _words(result: PlanResult) -> str:
    """A way in words: length, time, room, steps."""
    assert result.trajectory is not None
    assert result.certificate is not None
    steps, room = round(result.details.get("steps", 0.0)), result.certificate.min_clearance
    words = f"{result.trajectory.length:.2f} m in {result.trajectory.duration:.1f} s, clearance at least {room:.3f} m"
    return f"{words}, {steps} step{'s' * (steps > 1)} up to {result.certificate.max_step:.2f} m" if steps else words


def to_json(result: PlanResult) -> dict[str, Any]:
    """The result as plain values for `json.dumps`."""
    made: dict[str, Any] = {
        "status": result.status.value,
        "code": result.status.code,
        "message": result.message,
        "timings": result.timings,
        "details": result.details,
        "costs": result.costs.tolist(),
    }
    if result.alternatives:
        made["alternatives"] = [to_json(other) for other in result.alternatives]
    if result.trajectory is not None:
        path = result.trajectory
        made["length"], made["duration"] = path.length, path.duration
        made["trajectory"] = {key: getattr(path, key).tolist() for key in ("positions", "ground", "times", "headings")}
    if result.certificate is not None:
        proof = result.certificate
        made["certificate"] = {
            key: value.tolist() if hasattr(value, "tolist") else value
            for key, value in ((name, getattr(proof, name)) for name in type(proof).__slots__)
        }
    return made
