"""How long sentences take: the page that lists them is of today, and no voice needs more than the guide counts on."""

import re
import shutil

import pytest
from gpdf_guidance import LANGUAGES, Kind, Manner, phrase
from gpdf_guidance.speech import spoken_in

from gpdf_service.bench.spoken import WITHIN, example, judged
from tests.docs.blocks import ROOT

ROWS = re.findall(
    r"^\| (\w+) \| (.+?) \| ([\d.]+) \| (.+?) \| ([\d.]+) \| .+ \|$",
    (ROOT / "docs" / "reference" / "sentences.md").read_text(),
    re.MULTILINE,
)


def test_the_page_lists_every_sentence_as_it_is_said():
    said = {Kind(kind): (english, german) for kind, english, _, german, _ in ROWS}
    assert said == {kind: tuple(phrase(example(kind), Manner(name)) for name in ("en", "de")) for kind in Kind}


def test_no_voice_needs_more_than_is_counted_on_nor_much_less():
    measured = [(text, float(s)) for _, *pairs in ROWS for text, s in zip(pairs[::2], pairs[1::2], strict=True)]
    more = [spoken_in(text) - seconds for text, seconds in measured]
    assert min(more) > -0.05  # as the page rounds
    assert max(more) < 1.6


def test_what_is_told_of_a_turn_ahead_is_over_before_it_in_every_language():
    assert WITHIN[Kind.TURN_SOON] < WITHIN[Kind.STAIRS]
    assert all(spoken_in(phrase(example(kind), Manner(name))) <= s for kind, s in WITHIN.items() for name in LANGUAGES)


@pytest.mark.skipif(shutil.which("espeak-ng") is None, reason="needs espeak-ng")
@pytest.mark.parametrize("kind", [Kind.STAIRS, Kind.STEP, Kind.RESUME])
def test_the_page_says_what_the_voice_measures(kind):
    (listed,) = (pairs[1::2] for name, *pairs in ROWS if name == kind)
    assert [f"{judged(kind, name)['s']:.1f}" for name in ("en", "de")] == listed
