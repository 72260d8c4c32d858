"""Asking again what a log recorded, and telling what differs: the work of `gpdf replay`."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import cast

from gpdf_client import Client, ClientError
from gpdf_client.cli import connect
from gpdf_client.results import to_result
from gpdf_schemas import PlanReply, Status, keys
from msgspec.structs import replace
from tqdm import tqdm

from gpdf_service.scene import Scene
from gpdf_service.service.planning import agent_of
from gpdf_service.service.replay import Moved, Planned, compare, recorded_events
from gpdf_service.service.replay_inside import Course, InProcess
from gpdf_service.types import PlanResult


def replay(args: argparse.Namespace) -> int:
    """Ask again and compare; exit code 0 as `gpdf replay` has it."""
    damage: list[str] = []
    events = [
        event
        for event in recorded_events(args.log, damage)
        if isinstance(event, Moved) or _is_asked(event, args.request)
    ]
    for words in damage:
        print(f"gpdf: {args.log} is DAMAGED, and replayed without it: {words}", file=sys.stderr)
    plans = asked = [event for event in events if isinstance(event, Planned)]
    try:
        if args.scene or args.scenes_dir:
            again = InProcess(args.log, args.scene, args.scenes_dir)
            plans = [plan for plan in asked if again.knows(plan)]
            if asked and not plans:
                again.scene_of(asked[0])  # says what is missing
            replies = again.ask_all([event for event in events if isinstance(event, Moved) or again.knows(event)])
        else:
            with connect(args) as client:
                replies = _over_zenoh(client, events, at_recorded_speed=args.recorded_speed)
    except ClientError as error:
        print(f"gpdf: {error}", file=sys.stderr)
        return 1
    results = [compare(plan.request, plan.reply, now) for plan, now in zip(plans, replies, strict=True)]
    if args.png and results:
        index = next((i for i, result in enumerate(results) if not result.same), 0)
        _draw(again.scene_of(plans[index]), plans[index], replies[index], args.png)
    same = sum(result.same for result in results)
    if args.json:
        print(json.dumps([{**dataclasses.asdict(result), "same": result.same} for result in results]))
    else:
        for result in results:
            if not result.same:
                words = f"{result.status[0]} → {result.status[1]}, {result.deviation:.4f} m apart"
                print(f"{result.request_id}: {words}")
        print(f"{same} of {len(results)} plans are identical")
    if len(plans) < len(asked):
        words = "plans were not asked again: they were made in versions of scenes that are not given"
        print(f"gpdf: {len(asked) - len(plans)} {words}", file=sys.stderr)
    return 0 if results and same == len(asked) and not damage else 1


def _is_asked(plan: Planned, request_id: str | None) -> bool:
    """Whether a plan was made at all, in some scene, and is the one that is wanted."""
    return plan.reply.scene_version > 0 and request_id in (None, plan.request.request_id)


def _over_zenoh(client: Client, events: list[Planned | Moved], *, at_recorded_speed: bool) -> list[PlanReply]:
    """The replies of today; what moved when a plan was begun goes with it, so that it is the same at any speed."""
    replies, began, course = [], time.monotonic(), Course()
    for event in tqdm(events, desc="replay", unit="event", disable=not sys.stderr.isatty()):
        if isinstance(event, Moved):
            course.follow(event)
            continue
        if at_recorded_speed:
            time.sleep(max(0.0, (event.stamp_ns - events[0].stamp_ns) / 1e9 - (time.monotonic() - began)))
        request = replace(event.request, obstacles=[*course.at(event), *event.request.obstacles])
        replies.append(client.ask(keys.PLAN, request, PlanReply, request.deadline_s, fine=tuple(Status)))
    return replies


def _draw(scene: Scene, plan: Planned, now: PlanReply, path: Path) -> None:
    from gpdf_service.viewer.picture import draw_plans

    request = plan.request
    drawn = cast("dict[str, PlanResult]", {"recorded": to_result(plan.reply), "again": to_result(now)})
    title = f"request {request.request_id}: {request.method}"
    agent = agent_of(request.agent)
    draw_plans(scene, drawn, path, agent=agent, start=request.start, goal=request.goal, title=title)
