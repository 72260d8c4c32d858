"""The fenced blocks of the README and of the site's pages."""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
SNIPPET = re.compile(r'^--8<-- "(?P<file>[^":]+)"$', re.MULTILINE)
FENCE = re.compile(r"^(?P<fails><!-- fails -->\n)?```(?P<language>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page. `fails`: the page says that the command is refused."""

    line: int
    language: str
    text: str
    fails: bool


def blocks_of(page):
    """The fenced blocks of a Markdown file in their order, with what they include."""
    source = page.read_text()
    return [
        Block(
            source[: found.start("text")].count("\n") + 1,
            found["language"],
            SNIPPET.sub(lambda include: (ROOT / include["file"]).read_text(), found["text"]),
            found["fails"] is not None,
        )
        for found in FENCE.finditer(source)
    ]


def pages():
    """Every Markdown page whose code a reader would copy."""
    return [ROOT / "README.md", ROOT / "schemas" / "CONVENTIONS.md", *sorted((ROOT / "docs").rglob("*.md"))]
