"""The commands that documents name in passing: each verb and each option is there. Blocks are run by `test_blocks`."""

import re

import pytest
from blocks import ROOT
from test_words import documents

from gpdf_service.cli import GROUPS, _options, find_verb, parser_of

NAMED = re.compile(r"`(?:\.venv/bin/)?gpdf\s([^`]+)`")
GENERAL = {"--help", "--version"}


def commands(text):
    """The words of each command that a text names, where a line may end within one."""
    return [found.split() for found in NAMED.findall(text)]


def missing(words):
    """What of a command is not there."""
    verb = find_verb(words)
    if verb is None:
        whole = words[0] in {one for group in GROUPS.values() for one in group} or words[0] in GENERAL
        return [] if whole and len(words) == 1 else [" ".join(words)]
    known = {*_options(parser_of(verb)), *GENERAL}
    given = [word.partition("=")[0] for word in words if word.startswith("--")]
    return [f"{verb} {option}" for option in given if option not in known]


@pytest.mark.parametrize(
    "page", [*documents(), ROOT / "ARCHITECTURE.md"], ids=lambda page: page.relative_to(ROOT).as_posix()
)
def test_every_command_that_a_page_names_is_there(page):
    assert [what for words in commands(page.read_text()) for what in missing(words)] == []


def test_verbs_and_options_that_are_gone_are_found():
    text = "See `gpdf bench plan --ways\n--teleport 3`, `gpdf fly` and `gpdf scene info --png=x`."
    assert [missing(words) for words in commands(text)] == [["bench plan --teleport"], ["fly"], []]
