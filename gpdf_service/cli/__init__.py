"""`gpdf`: one command, a verb for each thing that the product does.

A verb is a module with `add_arguments(parser)` and `run(args) -> int`; it is imported only when it is asked for, so
that `gpdf client …` works with the light client's install and `gpdf --help` is instant.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path

from gpdf_service import __version__
from gpdf_service.cli.work import mortal
from gpdf_service.errors import GpdfError

VERBS: dict[str, tuple[str, str]] = {
    "serve": ("gpdf_service.service.serve_verb", "run the map service and the planner service"),
    "scene build": ("gpdf_service.cli.scene_build", "build a scene file from a point cloud"),
    "scene info": ("gpdf_service.cli.scene_info", "say what is in a scene or a cloud"),
    "scene crop": ("gpdf_service.cli.scene_crop", "cut a part out of a scene or a cloud"),
    "scene merge": ("gpdf_service.cli.scene_merge", "make one scene of several scenes or clouds"),
    "synthetic": ("gpdf_service.cli.synthetic", "make a random place, ray-cast by a scanner, with its truth"),
    "plan": ("gpdf_service.cli.plan", "plan in a scene or a cloud, without a service"),
    "client": ("gpdf_client.cli", "ask a running service"),
    "drive": ("gpdf_service.cli.drive", "drive a robot, or a simulated one, along a planned trajectory"),
    "ros2": ("gpdf_service.cli.ros2", "answer the goals of a ROS 2 robot with paths, without ROS here"),
    "replay": ("gpdf_service.service.replay_verb", "ask a service again what a log recorded, and compare"),
    "record check": ("gpdf_service.service.record_verb", "check a log, and mend what a crash left"),
    "bench field": ("gpdf_service.bench.field", "accuracy and speed of the distance fields beside a k-d tree"),
    "bench build": ("gpdf_service.bench.build", "time from cloud to scene beside Open3D's normals"),
    "bench ground": ("gpdf_service.bench.ground", "our ground segmentation beside true labels"),
    "bench plan": ("gpdf_service.bench.plan", "random queries: share certified, an independent judge, time"),
    "bench refusals": ("gpdf_service.bench.refusals", "how soon plans are refused, what helps then, who is late"),
    "bench paper": (
        "gpdf_service.bench.paper",
        "the paper's tables and figures: four methods, judged against the clean cloud",
    ),
    "bench drive": ("gpdf_service.bench.drive", "simulated robots on random errands: contacts, error of following"),
    "bench service": ("gpdf_service.bench.service", "what Zenoh, msgpack and the log add to a plan"),
    "bench fuzz": ("gpdf_service.bench.fuzz", "malformed requests against the real service, valid clients beside them"),
    "bench hostile": (
        "gpdf_service.bench.hostile",
        "clouds that nobody should send: what is answered, and what it takes",
    ),
    "bench crash": ("gpdf_service.bench.crash", "kill -9 at random moments: what was acknowledged is there, logs read"),
    "bench unread": ("gpdf_service.bench.unread", "clients that do not read their answers: what others wait"),
    "bench cut": ("gpdf_service.bench.cut", "a link that is cut for seconds: how soon a client is answered again"),
    "bench page": ("gpdf_service.bench.page", "the operator's page in a browser: from the press of a button to a path"),
    "bench soak": ("gpdf_service.bench.soak", "loads, plans and unloads for minutes: memory, threads and files of it"),
    "view": (
        "gpdf_service.viewer.view_verb",
        "a page in the browser: see scenes, plan by two clicks, step through logs",
    ),
    "bench guide": ("gpdf_service.bench.guide", "simulated people with human errors: contacts, arrivals, words"),
    "bench f921": ("gpdf_service.bench.f921", "the guide beside ITU-T F.921: each recommendation, with evidence"),
    "bench spoken": (
        "gpdf_service.bench.spoken",
        "every sentence read aloud: how long it takes, whether it is over in time",
    ),
    "guide": ("gpdf_service.cli.guide", "lead a person: instructions, speech and haptic cues from a stream of poses"),
    "belt": ("gpdf_service.cli.belt", "a vibrating belt (naviBelt) lets a guided person feel the cues"),
    "demo": ("gpdf_service.cli.demo", "see it happen: service, four bodies, picture and log"),
    "warm": ("gpdf_service.cli.warm", "compile every kernel for this machine, once, so that no verb waits for it"),
    "completion": ("gpdf_service.cli.completion", "what your shell needs to complete these words: bash, zsh or fish"),
}

GARBAGE = 50_000
"""New objects after which one looks for garbage. What is loaded stays: to look each 700, as by default, is 0.1 s."""

BRINGS = {
    "rosbags": "gpdf-service[ros2]",
    "viser": "gpdf-service[viewer]",
    "sklearn": "scikit-learn",
    "pybelt": "gpdf-service[belt]",
    "playwright": "playwright",
    **dict.fromkeys(("websockets", "segno", "cryptography"), "gpdf-service[phone]"),
}
"""What to install for a module that is missing; those that are not named here come with the extra `server`."""


GROUPS: dict[str, tuple[str, ...]] = {
    "see it": ("demo", "plan", "scene", "view", "synthetic"),
    "serve and ask": ("serve", "client"),
    "lead and drive": ("guide", "belt", "drive", "ros2"),
    "look back": ("replay", "record"),
    "measure": ("bench",),
    "the shell": ("completion", "warm"),
}
"""First words of verbs, by what one wants to do."""
EXIT_CODES = """exit codes
  0    the thing was done
  1    it was not: a plan without a path, a file that cannot be read, a service that does not answer
  2    the command line is wrong
  130  it was stopped by Ctrl-C
  141  whoever read the output stopped reading"""


def overview(first: str | None = None) -> str:
    """The list of verbs that `gpdf --help` prints; of those that begin with a word, `gpdf WORD --help`."""
    chosen = [verb for verb in VERBS if first in (None, verb.split()[0])]
    width = max(map(len, chosen))
    lines = []
    for title, words in GROUPS.items() if first is None else (("", (first,)),):
        lines += [title] if title else []
        lines += [f"  gpdf {verb:<{width}}  {VERBS[verb][1]}" for verb in chosen if verb.split()[0] in words] + [""]
    usage = f"usage: gpdf {first or ''}{' ' if first else ''}VERB [--help] …"
    return "\n".join([usage, "", *lines, EXIT_CODES, "", f"gpdf_service {__version__}"])


def find_verb(words: Sequence[str]) -> str | None:
    """The verb that a command line starts with, the longest that fits."""
    for count in (2, 1):
        if len(words) >= count and (verb := " ".join(words[:count])) in VERBS:
            return verb
    return None


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb. Returns the exit code: 0 success, 1 the work failed, 2 the command line is wrong."""
    gc.set_threshold(GARBAGE)
    words = list(sys.argv[1:] if argv is None else argv)
    verb, args = find_verb(words), None
    try:
        if verb is None:
            code = _without_verb(words)
        else:
            _announce(verb, words)
            with mortal() if argv is None else nullcontext():
                parser, rest = parser_of(verb), _joined(words[len(verb.split()) :])
                if meant := _meant(parser, rest):
                    parser.error(meant)
                args = parser.parse_args(rest)
            if "numba" in sys.modules and sys.stderr.isatty():  # loaded by the verb's module, or not at all
                import_module("gpdf_service.cli.compiling").tell_of_compiling()
            code = int(import_module(VERBS[verb][0]).run(args))
        sys.stdout.flush()
        return code
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in ("", "gpdf_service", "gpdf_client", "gpdf_schemas"):
            raise
        package = BRINGS.get(missing, "gpdf-service[server]")
        print(f"gpdf {verb} needs {missing}: pip install '{package}'", file=sys.stderr)
        return 1
    except BrokenPipeError:  # `gpdf … | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left is flushed into nothing
        return 141
    except (GpdfError, OSError) as error:  # OSError: a file that cannot be written, a disk that is full
        return _report(error, as_json=getattr(args, "json", False))
    except KeyboardInterrupt:
        return 130


def _announce(verb: str, words: list[str]) -> None:
    """Say at once what a bench measures, or which cloud is not there: what it measures with takes seconds to load."""
    if not verb.startswith("bench ") or {"-h", "--help"} & set(words):
        return
    print(f"gpdf {verb}: {VERBS[verb][1]}", file=sys.stderr)
    inputs = import_module("gpdf_service.cli.inputs")
    for before, word in zip(["", *words], words, strict=False):
        name = word.rpartition("=")[2]  # also of NAME=CLOUD
        if (before == "--scene" or word.startswith("--scene=")) and inputs.is_file_name(name):
            inputs.check_there(Path(name))


def _without_verb(words: list[str]) -> int:
    """Help of everything, or of the verbs that begin with a word; the verb that was meant, where there is one near."""
    if words[:1] == ["--version"]:
        print(__version__)
        return 0
    group = words[0] if words and any(verb.startswith(f"{words[0]} ") for verb in VERBS) else None
    if words[:1] in (["--help"], ["-h"]) or (group and words[1:2] in (["--help"], ["-h"])):
        print(overview(group))
        return 0
    if not words or (group and len(words) == 1):
        print(overview(group), file=sys.stderr)
        return 2
    known = [verb for verb in VERBS if group is None or verb.startswith(f"{group} ")]
    typed = " ".join(words[: 2 if group else 1])
    near = get_close_matches(typed, known, n=1) or get_close_matches(" ".join(words[:2]), known, n=1)
    hint = f"Did you mean `gpdf {near[0]}`?" if near else f"`gpdf {f'{group} ' if group else ''}--help` lists them."
    print(f"gpdf: there is no verb {typed!r}. {hint}", file=sys.stderr)
    return 2


def parser_of(verb: str, parser: argparse.ArgumentParser | None = None) -> argparse.ArgumentParser:
    """The options of a verb, put into `parser` if one is given."""
    module_name, text = VERBS[verb]
    made = parser or argparse.ArgumentParser(prog=f"gpdf {verb}", description=text)
    import_module(module_name).add_arguments(made)
    return made


def _meant(parser: argparse.ArgumentParser, words: Sequence[str]) -> str:
    """Which option is near one that is none, in words; argparse would name one that is missing for it."""
    known = list(_options(parser))
    for name in (word.partition("=")[0] for word in words if word.startswith("--")):
        near = get_close_matches(name, known, n=1)
        if near and not any(one.startswith(name) for one in known):  # it takes the begin of an option for it
            return f"there is no option {name}. Did you mean {near[0]}?"
    return ""


def _options(parser: argparse.ArgumentParser) -> Iterator[str]:
    """All options of a parser and of those for what is asked of a service."""
    for action in parser._actions:
        yield from action.option_strings
        for one in (action.choices or {}).values() if isinstance(action, argparse._SubParsersAction) else ():
            yield from _options(one)


def _joined(words: Sequence[str]) -> list[str]:
    """Tie `--start -1,2` together as `--start=-1,2`: argparse would take the place for an option."""
    joined: list[str] = []
    for word in words:
        if re.match(r"-[\d.]", word) and joined and re.fullmatch(r"--[a-z][a-z-]*", joined[-1]):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _report(error: Exception, *, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"error": type(error).__name__, "message": str(error)}))
    print(f"gpdf: {error}", file=sys.stderr)
    return 1
