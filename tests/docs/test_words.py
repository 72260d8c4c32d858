"""The documents read well: short sentences, lines that fit, and a README that one reads to its end."""

import re

import pytest
from blocks import ROOT

LONGEST_SENTENCE = 40
"""Words."""
LONGEST_LINE = 120
"""Characters; a table's row and a picture's line cannot be broken."""
FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[([^]]*)]\([^)]*\)")
END = re.compile(r"(?<=[.!?:;])[\"')*_]*\s+(?=[\"'(*_`]*[A-Z0-9`])")
NOTES = "lab"
"""docs/lab is dated and kept as it was written: its lines fit, its sentences are its own."""
GENERATED = "measured"


def documents(kept=True):
    """README, DECISIONS and the pages of the site; the laboratory's notes only where `kept` is False."""
    pages = sorted((ROOT / "docs").rglob("*.md"))
    pages = [
        page
        for page in pages
        if page.relative_to(ROOT / "docs").parts[0] not in ({GENERATED, NOTES} if kept else {GENERATED})
    ]
    return [ROOT / "README.md", ROOT / "DECISIONS.md", *pages]


def is_whole(line):
    """A line that Markdown does not let one break."""
    return line.startswith(("|", "![")) or " " not in line.strip()


def sentences(text):
    """The sentences of a page's running text, without code, tables, headings and what links lead to."""
    text = FENCED.sub("\n\n", text)
    for part in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", text):
        if not part.lstrip().startswith(("|", "#", "![", "<!--", "--8<--", ":::")):
            yield from END.split(LINK.sub(r"\1", " ".join(part.split())))


@pytest.mark.parametrize("page", documents(), ids=lambda page: page.relative_to(ROOT).as_posix())
def test_no_sentence_is_longer_than_one_reads_in_a_breath(page):
    assert [said for said in sentences(page.read_text()) if len(said.split()) > LONGEST_SENTENCE] == []


@pytest.mark.parametrize("page", documents(kept=False), ids=lambda page: page.relative_to(ROOT).as_posix())
def test_no_line_is_wider_than_an_editor(page):
    lines = FENCED.sub("", page.read_text()).splitlines()
    assert [line for line in lines if len(line) > LONGEST_LINE and not is_whole(line)] == []


def test_long_sentences_and_lines_are_found():
    """The two tests above, on a page that fails both."""
    long = "Word " * 41 + "end."
    assert [len(said.split()) for said in sentences(f"# Head\n\n{long} Next one.\n\n| {long} |\n")] == [42, 2]
    assert not is_whole(long)
    assert is_whole("| " + long)


def test_the_readme_is_read_to_its_end():
    text = FENCED.sub("", (ROOT / "README.md").read_text())
    assert len(text.split()) <= 900


def test_decisions_are_few_and_short():
    entries = re.split(r"^### ", (ROOT / "DECISIONS.md").read_text(), flags=re.MULTILINE)[1:]
    assert len(entries) <= 40
    bodies = [re.split(r"^## ", entry, flags=re.MULTILINE)[0].strip() for entry in entries]
    assert [body.splitlines()[0] for body in bodies if len(body.splitlines()) > 10] == []


def test_the_tests_that_a_page_names_are_there():
    named = [name for page in documents(kept=False) for name in re.findall(r"tests/[\w/]+\.py::\w+", page.read_text())]
    assert len(named) > 20
    for path, _, test in (name.partition("::") for name in named):
        assert f"def {test}(" in (ROOT / path).read_text(), f"{path} has no {test}"


def test_the_files_that_a_document_names_are_there():
    """In backticks, from the root or by a test's name alone; the laboratory's notes are of their day."""
    tests = {path.name for path in (ROOT / "tests").rglob("test_*.py")}
    named = 0
    for document in [ROOT / "ARCHITECTURE.md", *documents()]:
        text = FENCED.sub("", document.read_text())
        from_root = set(
            re.findall(r"`(?:pytest )?((?:tests|gpdf_service|clients|schemas|docs|docker)/[\w./*-]+)", text)
        )
        by_name = set(re.findall(r"`(test_\w+\.py)`", text))
        named += len(from_root | by_name)
        assert [name for name in sorted(from_root) if not [*ROOT.glob(name)]] == [], document
        assert sorted(by_name - tests) == [], document
    assert named > 100
