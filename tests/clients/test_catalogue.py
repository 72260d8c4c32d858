"""Every sentence in every language: none is missing, none leaves a number out, each says what matters."""

import dataclasses
import re
from pathlib import Path

import gpdf_guidance
import pytest
from gpdf_guidance import LANGUAGES, Instruction, Kind, Manner, Side, Urgency, phrase
from gpdf_guidance.catalogue import language
from gpdf_schemas import CueAction

GERMAN, STEPS = Manner("de"), Manner(unit="steps", step_length=0.65)
AMOUNTS = {Kind.NO_WAY_TIGHT: (0.75, 0.05)}
PLACES = re.compile(r"{(\w+)}")
SAYS_AN_AMOUNT = {
    Kind.TURN_NOW,
    Kind.TURN_BACK,
    Kind.TURN_SOON,
    Kind.HEAD,
    Kind.BEAR,
    Kind.STEP,
    Kind.STEP_EDGE,
    Kind.STAIRS,
    Kind.STAIRS_EDGE,
    Kind.ON_STAIRS,
    Kind.RAMP,
    Kind.NO_WAY_TIGHT,
    Kind.ASK_STEP,
    Kind.ASK_STEP_OR_DETOUR,
}


def full(kind, amount=1.0):
    """An instruction of which every part is there."""
    far = Instruction(Kind.HOW_FAR, Urgency.INFORM, distance=20.0, seconds=40.0)
    return Instruction(
        kind,
        Urgency.ACT,
        distance=2.4,
        amount=amount,
        count=7,
        then=() if kind is Kind.OVERVIEW else (far,),
        name="kitchen",
        side=Side.LEFT,
        free=(0.2, 1.0, 2.0, 3.0),
        seconds=75.0,
    )


def test_there_are_languages_and_a_file_is_all_that_one_needs():
    folder = Path(gpdf_guidance.__file__).parent / "languages"
    assert sorted(LANGUAGES) == sorted(path.stem for path in folder.glob("*.toml"))
    assert {"en", "de"} <= set(LANGUAGES)


@pytest.mark.parametrize("name", LANGUAGES)
@pytest.mark.parametrize("kind", Kind)
def test_every_instruction_has_a_sentence_in_every_language(kind, name):
    texts = {phrase(full(kind, amount), Manner(name)) for amount in AMOUNTS.get(kind, (1.0, -1.0))}
    assert all(text and "{" not in text and text[-1] in ".!?" for text in texts)
    assert (len(texts) == 2) == (kind in SAYS_AN_AMOUNT)  # left is not right, up is not down


@pytest.mark.parametrize("name", LANGUAGES)
def test_a_translation_has_what_the_english_has(name):
    english, other = language("en"), language(name)
    assert set(other.sentences) == set(Kind)
    assert set(other.words) == set(english.words)
    for kind in Kind:
        assert set(PLACES.findall(other.sentences[kind])) == set(PLACES.findall(english.sentences[kind])), kind
    for word in english.words:
        assert set(PLACES.findall(other.words[word])) == set(PLACES.findall(english.words[word])), word
    assert all(text == text.strip() and text for text in other.sentences.values())


@pytest.mark.parametrize("name", LANGUAGES)
def test_the_page_has_every_text_that_it_shows_in_every_language(name):
    page, texts = Path(gpdf_guidance.__file__).parent / "page", language(name).page
    marks = set(re.findall(r"{{(\w+)}}", (page / "index.html").read_text())) - {"language", "texts"}
    used = set(re.findall(r"texts\.(\w+)", (page / "guide.js").read_text())) - {Kind.STOP_ALONE.value}
    assert marks | used | {action.value for action in CueAction} - {"turn"} == set(texts)  # none missing, none unused
    for key, text in language("en").page.items():
        assert set(PLACES.findall(texts[key])) == set(PLACES.findall(text)), key
    assert all(text == text.strip() and text for text in texts.values())


def test_the_page_holds_no_words_of_a_language_of_its_own():
    body = (Path(gpdf_guidance.__file__).parent / "page" / "index.html").read_text()
    shown = [text.strip() for text in re.findall(r">([^<]+)<", body)]
    assert [text for text in shown if text and not re.fullmatch(r"{{\w+}}", text)] == []
    script = (Path(gpdf_guidance.__file__).parent / "page" / "guide.js").read_text()
    assert re.findall(r"""["'`][A-Z][a-z]+[ .]""", script) == []  # a sentence, or the first word of one


def test_a_language_without_a_sentence_is_refused(tmp_path, monkeypatch):
    import gpdf_guidance.catalogue as catalogue

    text = (Path(gpdf_guidance.__file__).parent / "languages" / "en.toml").read_text()
    (tmp_path / "languages").mkdir()
    (tmp_path / "languages" / "xx.toml").write_text(text.replace("stairs_edge =", "stairs_edgy ="))
    monkeypatch.setattr(catalogue.resources, "files", lambda _: tmp_path)
    with pytest.raises(KeyError, match="stairs_edge"):
        language("xx")


def test_what_must_be_heard_at_once_begins_with_the_word_for_it():
    for name, word in (("en", "Stop."), ("de", "Halt.")):
        for kind in Kind:
            text = phrase(full(kind), Manner(name))
            assert text.startswith(word) == (kind.value.startswith(("stop_", "arrived"))), kind


def test_distances_are_never_more_than_it_is():
    step = Instruction(Kind.STEP, Urgency.ACT, distance=2.4, amount=-0.17)
    assert phrase(step) == "In 2 metres, step down, 17 centimetres."
    assert phrase(step, STEPS) == "In 3 paces, step down, 17 centimetres."
    assert phrase(step, GERMAN) == "In 2 Metern Stufe abwärts, 17 Zentimeter."
    straight_on = Instruction(Kind.GO_ON, Urgency.INFORM, distance=3.8)
    assert phrase(straight_on) == "Walk straight on, 3 metres."
    assert phrase(straight_on, STEPS) == "Walk straight on, 5 paces."  # the sixth is not whole
    assert phrase(straight_on, GERMAN) == "Gehen Sie geradeaus, 3 Meter."
    near = dataclasses.replace(step, distance=0.3)
    assert phrase(near) == "Just ahead, step down, 17 centimetres."
    own = dataclasses.replace(STEPS, step_length=0.5)
    assert phrase(straight_on, own) == "Walk straight on, 7 paces."


def test_stairs_say_how_many_steps_and_where_the_handrail_is():
    stairs = Instruction(Kind.STAIRS, Urgency.ACT, distance=1.0, amount=0.17, count=12)
    assert phrase(stairs) == "In 1 metre, take the stairs up, 12 steps."
    for side, words in ((Side.LEFT, "on the left"), (Side.RIGHT, "on the right"), (Side.BOTH, "both sides")):
        assert words in phrase(dataclasses.replace(stairs, side=side))
    later = dataclasses.replace(stairs, distance=1.5, after=1.0)  # counted from where those end
    assert phrase(later) == "After these stairs: In 1 metre, take the stairs up, 12 steps."
    ending = dataclasses.replace(stairs, ends=True)
    assert phrase(ending) == "The stairs end. In 1 metre, take the stairs up, 12 steps."
    on = Instruction(Kind.GO_ON, Urgency.INFORM, distance=4.2)
    top = Instruction(Kind.STAIRS_END, Urgency.ACT, then=(on,))
    assert phrase(top) == "The stairs end. Walk straight on, 4 metres."


def test_turns_say_the_side_and_a_clock_who_wants_one():
    turn = Instruction(Kind.TURN_SOON, Urgency.ACT, distance=0.4, amount=1.5, ends=True)
    assert phrase(turn) == "The stairs end. Turn left."
    assert phrase(turn, GERMAN) == "Die Treppe endet. Drehen Sie sich nach links."
    stairs = Instruction(Kind.STAIRS, Urgency.ACT, distance=2.6, amount=0.17, count=12)
    leading = dataclasses.replace(stairs, first=dataclasses.replace(turn, distance=2.1, ends=False))
    assert phrase(leading) == "In 2 metres, turn left. Then, take the stairs up, 12 steps."
    named = dataclasses.replace(turn, distance=2.1, ends=False, name="the kitchen door")
    assert phrase(named) == "In 2 metres at the kitchen door, turn left."
    now = Instruction(Kind.TURN_NOW, Urgency.ACT, amount=-1.5)
    assert phrase(now) == "Turn right."
    assert phrase(dataclasses.replace(now, amount=3.0)) == "Turn around."
    assert phrase(dataclasses.replace(now, amount=-0.7)) == "Turn slightly right."
    assert phrase(now, Manner(clock=True)) == "Turn to 3 o'clock."
    assert phrase(dataclasses.replace(now, amount=0.55), Manner(clock=True)) == "Turn to 11 o'clock."
    back = Instruction(Kind.TURN_BACK, Urgency.ACT, amount=0.3)
    assert phrase(back, GERMAN) == "Zu weit. Drehen Sie sich etwas zurück nach links."


def test_an_overview_names_length_turns_stairs_and_time():
    parts = (Instruction(Kind.STAIRS, Urgency.INFORM, amount=0.17, count=16),)
    parts += (Instruction(Kind.STEP, Urgency.INFORM, amount=-0.15),)
    way = Instruction(Kind.OVERVIEW, Urgency.ACT, distance=12.6, count=2, then=parts, name="kitchen", seconds=64.0)
    assert phrase(way) == (
        "Kitchen: walk 12 metres, 2 turns, stairs up with 16 steps, a step down of 15 centimetres, about 1 minute."
    )
    flights = dataclasses.replace(way, count=0, then=(parts[0], dataclasses.replace(parts[0], count=3)))
    assert phrase(flights) == "Kitchen: walk 12 metres, stairs up with 16 and 3 steps, about 1 minute."
    down = dataclasses.replace(flights, then=(parts[0], dataclasses.replace(parts[0], amount=-0.17)))
    assert "stairs up with 16 steps, stairs down with 16 steps" in phrase(down)
    short = dataclasses.replace(way, count=0, then=(), name="", seconds=12.0)
    assert phrase(short) == "The goal: walk 12 metres, about 20 seconds."
    assert phrase(dataclasses.replace(short, count=1), GERMAN) == (
        "Das Ziel: Gehen Sie 12 Meter, einmal abbiegen, etwa 20 Sekunden."
    )


def test_an_overview_ends_with_what_is_to_be_done_first():
    around = Instruction(Kind.TURN_NOW, Urgency.ACT, amount=3.0)
    soon = Instruction(Kind.STAIRS, Urgency.ACT, distance=2.4, amount=-0.17, count=9)
    way = Instruction(Kind.OVERVIEW, Urgency.ACT, distance=4.6, count=0, first=around, soon=soon, seconds=15.0)
    assert phrase(way) == (
        "The goal: walk 4 metres, about 20 seconds. Turn around. In 2 metres, take the stairs down, 9 steps."
    )


def test_a_refusal_says_the_room_that_there_is_and_that_is_needed():
    tight = Instruction(Kind.NO_WAY_TIGHT, Urgency.DANGER, amount=0.0713, distance=0.08)
    assert "leaves only 7 centimetres beside you, and you need 8." in phrase(tight)
    ways = Instruction(Kind.ASK_STEP_OR_DETOUR, Urgency.ACT, distance=10.0, amount=-0.35)
    ways = dataclasses.replace(ways, then=(Instruction(Kind.HOW_FAR, Urgency.INFORM, distance=90.0),))
    assert "10 metres over a step down of 35 centimetres, or 90 metres without it" in phrase(ways)


def test_what_is_around_is_told_side_by_side():
    around = Instruction(Kind.AROUND, Urgency.ACT, free=(3.0, 0.3, 1.2, 2.0))
    assert phrase(around) == (
        "Around you: ahead free, right something within reach, behind something at 1 metre, left something at 2 metres."
    )
