"""`gpdf completion bash|zsh|fish`: print what the shell needs to complete verbs, options and files.

bash: `gpdf completion bash > ~/.local/share/bash-completion/completions/gpdf`; zsh: into a file `_gpdf` in a folder of
`$fpath`; fish: into `~/.config/fish/completions/gpdf.fish`. New shells then know it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import shtab

from gpdf_service.cli import VERBS, parser_of

SHELLS = ("bash", "zsh", "fish")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("shell", choices=SHELLS)


def run(args: argparse.Namespace) -> int:
    """Print the shell's script."""
    print(shtab.complete(whole_parser(), args.shell))
    return 0


def whole_parser() -> argparse.ArgumentParser:
    """All verbs as one parser; one whose extra is not installed has its name alone."""
    root = argparse.ArgumentParser(prog="gpdf")
    root.add_argument("--version", action="store_true", help="print the version")
    groups = {"": root.add_subparsers()}
    for verb, (_, text) in VERBS.items():
        group, _, name = verb.rpartition(" ")
        if group not in groups:
            groups[group] = groups[""].add_parser(group, help=f"{group} …").add_subparsers()
        parser = groups[group].add_parser(name, help=text, description=text)
        try:
            parser_of(verb, parser)
        except ModuleNotFoundError:
            continue
        for action in parser._actions:
            if action.type is Path:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
    return root
