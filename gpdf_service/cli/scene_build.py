"""`gpdf scene build CLOUD --out FILE`."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

from gpdf_service.cli.bodies import read_agent
from gpdf_service.cli.inputs import SCENE_SUFFIX, add_cloud_arguments, check_in, check_out, open_scene
from gpdf_service.cli.work import Work
from gpdf_service.types import resolve_agent


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_cloud_arguments(parser)
    parser.add_argument("--out", type=Path, help="the scene file; the cloud's name with .gpdf when not given")
    parser.add_argument(
        "--agent", action="append", default=[], help="find its free space too, and keep it in the file (repeatable)"
    )
    parser.add_argument("--agent-file", type=Path, help="a TOML file with a body of your own, for the same")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Build, save, say what was built."""
    agents = [resolve_agent(agent) for agent in args.agent]
    if args.agent_file is not None:
        agents.append(read_agent(args.agent_file))
    target = args.out or args.input.with_suffix(SCENE_SUFFIX)
    check_out(target)
    check_in(args)
    began = time.perf_counter()
    with Work("read", "build", *["fit"] * bool(agents)) as work:
        scene = open_scene(args.input, args, work)
        for i, agent in enumerate(agents):
            with work.step("fit") as progress:
                progress(f"find where {agent.name} fits", i / len(agents))
                scene.free_space(agent)
    seconds = time.perf_counter() - began
    scene.save(target)
    info = scene.info()
    if args.json:
        print(json.dumps({"file": str(target), "seconds": seconds, **info}))
    else:
        print(f"{target}: {info['points']} points, {len(info['levels'])} level(s), built in {seconds:.2f} s")
    return 0
