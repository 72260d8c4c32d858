"""`gpdf replay LOG`: ask a running service again, or plan in process, and compare."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import cast

import msgspec
from gpdf_client import Client
from gpdf_client.client import DEFAULT_ENDPOINT
from gpdf_client.results import to_result
from gpdf_schemas import PlanReply, PlanRequest, Status, keys

from gpdf_service.errors import RequestError
from gpdf_service.service.handlers import Handlers
from gpdf_service.service.planning import agent_of
from gpdf_service.service.replay import Ask, compare, recorded_plans
from gpdf_service.service.scenes import Shelf
from gpdf_service.types import PlanResult


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("log", type=Path, help="a log (.mcap)")
    parser.add_argument("--endpoint", default=DEFAULT_ENDPOINT, help="the service to ask")
    parser.add_argument("--scene", action="append", default=[], metavar="NAME=CLOUD", help="plan in process with it")
    parser.add_argument("--request", help="only the request with this id")
    parser.add_argument(
        "--png", type=Path, help="draw the first plan that differs (or the first), was and is; with --scene"
    )
    parser.add_argument("--json", action="store_true", help="print the comparisons as JSON")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if every answer is the same."""
    if not args.log.is_file():
        print(f"gpdf: there is no log {args.log}", file=sys.stderr)
        return 1
    if args.png and not args.scene:
        print("gpdf: --png draws on a scene: name it with --scene NAME=CLOUD", file=sys.stderr)
        return 1
    plans = [pair for pair in recorded_plans(args.log) if args.request in (None, pair[0].request_id)]
    if args.scene:
        ask, shelf = _in_process(args.scene)
        replies = [ask(request) for request, _ in plans]
        results = [compare(request, was, now) for (request, was), now in zip(plans, replies, strict=True)]
        if args.png and results:
            index = next((i for i, result in enumerate(results) if not result.same), 0)
            _draw(shelf, *plans[index], replies[index], args.png)
    else:
        with Client.connect(args.endpoint) as client:
            ask = _over_zenoh(client)
            results = [compare(request, was, ask(request)) for request, was in plans]
    same = sum(result.same for result in results)
    if args.json:
        print(json.dumps([{**dataclasses.asdict(result), "same": result.same} for result in results]))
    else:
        for result in results:
            if not result.same:
                words = f"{result.status[0]} → {result.status[1]}, {result.deviation:.4f} m apart"
                print(f"{result.request_id}: {words}")
        print(f"{same} of {len(results)} plans are identical")
    return 0 if results and same == len(results) else 1


def _over_zenoh(client: Client) -> Ask:
    def ask(request: PlanRequest) -> PlanReply:
        reply: PlanReply = client.ask(keys.PLAN, request, PlanReply, request.deadline_s, fine=tuple(Status))
        return reply

    return ask


def _draw(shelf: Shelf, request: PlanRequest, was: PlanReply, now: PlanReply, path: Path) -> None:
    from gpdf_service.viewer.picture import draw_plans

    entry = shelf.get(request.scene)
    if entry is None or entry.scene is None:
        raise RequestError("--png", f"the log's scene {request.scene!r} is not given", "Name it with --scene.")
    drawn = cast("dict[str, PlanResult]", {"recorded": to_result(was), "again": to_result(now)})
    title = f"request {request.request_id}: {request.method}"
    agent = agent_of(request.agent)
    draw_plans(entry.scene, drawn, path, agent=agent, start=request.start, goal=request.goal, title=title)


def _in_process(scenes: list[str]) -> tuple[Ask, Shelf]:
    shelf = Shelf(Path())
    for text in scenes:
        name, _, path = text.partition("=")
        shelf.load_file(name, path, inside=False)
    shelf.settle()
    handlers = Handlers(shelf, "replay")

    def ask(request: PlanRequest) -> PlanReply:
        reply = handlers.answer(keys.PLAN, msgspec.msgpack.encode(request), time.monotonic())
        assert isinstance(reply, PlanReply)
        return reply

    return ask, shelf
