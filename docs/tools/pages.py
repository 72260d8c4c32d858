"""What mkdocs makes itself at each build: the pages of the command line, the messages and the measured tables."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from gpdf_service.cli import VERBS, parser_of

ROOT = Path(__file__).parent.parent.parent
HELP_COLUMNS = "100"
"""Width of the help texts: as wide as a block of code on the page."""
UNITS = {"m": " [m]", "ms": " [ms]", "s": " [s]", "us": " [µs]", "deg": " [°]"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    for path, text in (
        ("reference/cli.md", command_line()),
        ("reference/messages.md", messages(ROOT / "schemas" / "json")),
        ("measured.md", measured(ROOT / "docs" / "measured")),
    ):
        files.append(File.generated(config, path, content=text))
    return files


def command_line() -> str:
    """The help of every verb, as the program prints it."""
    os.environ["COLUMNS"] = HELP_COLUMNS
    parts = [
        "# Command line\n\nWhat `--help` prints. Results go to standard output, everything else to standard error;"
    ]
    parts.append("the exit code is 0 only when the thing was done.\n")
    for verb in VERBS:
        parser = parser_of(verb)
        parts.append(f"## gpdf {verb}\n\n```text\n{parser.format_help()}```\n")
        parts += [
            f"### gpdf {verb} {name}\n\n```text\n{sub.format_help()}```\n"
            for action in parser._actions
            if isinstance(action, argparse._SubParsersAction)
            for name, sub in action.choices.items()
        ]
    return "\n".join(parts)


def messages(folder: Path) -> str:
    """A table of the fields of every message, from the JSON Schema that stands beside it."""
    parts = [
        "# Messages\n\nGenerated from `schemas/json`. Keys, arrays and the rules that hold for all of them: "
        "[Conventions of the wire](wire.md).\n"
    ]
    shared: dict[str, Any] = {}
    for file in sorted(folder.glob("*.json")):
        defined = json.loads(file.read_text())["$defs"]
        shared |= {name: made for name, made in defined.items() if name != file.stem}
        parts.append(_message(file.stem, defined[file.stem]))
    parts.append("# Parts of messages\n")
    parts += [_message(name, made) for name, made in sorted(shared.items()) if f"## {name}\n" not in "".join(parts)]
    return "\n".join(parts)


def _message(name: str, schema: dict[str, Any]) -> str:
    about, _, listed = schema.get("description", "").partition("Attributes:")
    words = _attributes(listed)
    lines = [f"## {name}\n", " ".join(about.split()), ""]
    if "enum" in schema:
        return "\n".join([*lines, ", ".join(f"`{word}`" for word in schema["enum"]), ""])
    lines += ["| field | type | must be there | meaning |", "|---|---|---|---|"]
    for field, kind in schema.get("properties", {}).items():
        needed = "yes" if field in schema.get("required", ()) else "no"
        lines.append(f"| `{field}` | {_kind(kind)} | {needed} | {words.get(field, kind.get('description', ''))} |")
    return "\n".join([*lines, ""])


def _attributes(listed: str) -> dict[str, str]:
    """The lines `name: meaning` of a docstring, with what they are continued by."""
    found: dict[str, str] = {}
    name = ""
    lines = listed.strip("\n").splitlines()
    indent = min((len(line) - len(line.lstrip()) for line in lines if line.strip()), default=0)
    for line in lines:
        if line.strip() and len(line) - len(line.lstrip()) == indent:
            name, _, rest = line.strip().partition(":")
            found[name] = rest.strip().replace("|", "\\|")
        elif name:
            found[name] += f" {line.strip()}".replace("|", "\\|")
    return found


def _kind(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(_kind(part) for part in schema["anyOf"])
    if "enum" in schema:
        return " or ".join(f"`{value}`" for value in schema["enum"])
    if schema.get("type") == "array":
        inner = schema.get("items") or next(iter(schema.get("prefixItems", ())), None)
        return f"array of {_kind(inner)}" if isinstance(inner, dict) else "array"
    return str(schema.get("type", "anything"))


def measured(folder: Path) -> str:
    """A table of each benchmark's rows, as `gpdf bench … --json` printed them."""
    parts = ["# Accuracy and speed\n\nWhat the benchmarks printed, unedited; `make measure` measures them again."]
    parts.append("An independent judge, which shares no code with the planner, counts the collisions.\n")
    for file in sorted(folder.glob("*.json")):
        found = json.loads(file.read_text())
        names = list(dict.fromkeys(name for row in found["rows"] for name in row))
        parts.append(f"## {found['command']}\n\n{found['date']}, {found['machine']}, {found['load']}.\n")
        parts.append("| " + " | ".join(map(_heading, names)) + " |")
        parts.append("|" + "---|" * len(names))
        parts += ["| " + " | ".join(_cell(row.get(name, "")) for name in names) + " |" for row in found["rows"]]
        parts.append("")
    return "\n".join(parts)


def _heading(name: str) -> str:
    words, _, unit = name.rpartition("_")
    return f"{words.replace('_', ' ')}{UNITS[unit]}" if unit in UNITS and words else name.replace("_", " ")


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
