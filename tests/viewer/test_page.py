"""The operator's page in a real browser, on a real service; SIGKILL included."""

import re
import shutil
import threading
import time

import numpy as np
import pytest
from driving import until
from gpdf_client import Client
from gpdf_schemas import CueAction, CueMessage, PoseMessage, encode, keys
from house import PAINTED, STOREY

from gpdf_service.synthetic import SCENES
from gpdf_service.types import AGENTS
from gpdf_service.viewer import colours
from gpdf_service.viewer.panel import AS_SCANNED
from gpdf_service.viewer.profile import known_clearance

pytestmark = [pytest.mark.slow, pytest.mark.browser]
ONTO_THE_STEP = (5.5, 1.0, 0.0), (5.5, 2.2, 0.35)


def shade(operator, place):
    """What a place of the scene looks like."""
    return np.median(operator.around(operator.picture(), place).reshape(-1, 3), axis=0)


def path_on_screen(operator):
    """Waypoints of the path that is shown, on the ground."""
    path = operator.page.plans.paths.shown
    return None if path is None else path.ground


def test_two_clicks_draw_a_path(operator):
    operator.settle()
    before = operator.picture()
    operator.plans((0.9, 0.9, 0.0), (5.4, 3.4, 0.0))
    operator.sees(r"of clearance everywhere")
    ends = operator.page.plans.ends
    np.testing.assert_allclose(ends["start"], (0.9, 0.9, 0.0), atol=0.05)  # the click's ray met the ground there
    np.testing.assert_allclose(ends["goal"], (5.4, 3.4, 0.0), atol=0.05)
    operator.settle()
    change = np.abs(operator.picture() - before).max(axis=2)
    drawn = [operator.around(change, place).max() > 40 for place in path_on_screen(operator)]
    assert np.mean(drawn) > 0.8  # a line from start to goal; the labels hide some of it
    assert np.median(operator.around(change, (0.3, 4.5, 0.0))) < 40  # nothing in the far corner but points drawn anew
    operator.sees("From the side")
    operator.sees(r"Answer after \d+ ms")
    assert operator.errors == []


@pytest.mark.parametrize("name", ["dual_gpdf", "astar"])
def test_a_line_has_the_colour_that_its_legend_shows(operator, name):
    operator.plans((0.9, 0.9, 0.0), (5.4, 3.4, 0.0))
    until(lambda: path_on_screen(operator) is not None)
    paths = operator.page.plans.paths
    path, middle = paths.shown, path_on_screen(operator)[len(path_on_screen(operator)) // 2]
    paths.clear()
    paths.add_line("test", path, np.array(colours.METHODS[name], np.uint8))
    operator.settle()
    seen = operator.around(operator.picture(), middle, 6).reshape(-1, 3)
    assert np.abs(seen - colours.METHODS[name]).max(axis=1).min() < 25
    paths.clear()


def test_a_path_is_drawn_before_the_room_along_it_is_known(operator, monkeypatch):
    asked, go = threading.Event(), threading.Event()

    def slow(*args):
        asked.set()
        go.wait(60)
        return known_clearance(*args)

    monkeypatch.setattr("gpdf_service.viewer.planning.known_clearance", slow)
    operator.plans((0.9, 0.9, 0.0), (5.4, 3.4, 0.0))
    assert asked.wait(60)
    until(lambda: operator.page.plans.paths.drawn == ("line_plan",))
    go.set()
    until(lambda: operator.page.plans.paths.drawn == ("line_plan", "sweep", "body"))
    assert path_on_screen(operator) is not None
    assert operator.errors == []


def test_the_words_of_an_answer_wait_for_nothing_that_is_drawn(operator, monkeypatch):
    browser, sent = operator.page.desk.browser, []
    for whose, name in ((browser, "flush"), (browser.scene, "add_cylinder"), (browser.scene, "add_line_segments")):
        was = getattr(whose, name)

        def noted(*args, was=was, name=name, **more):
            sent.append((name, operator.page.panel.plan.answer.content))
            return was(*args, **more)

        monkeypatch.setattr(whose, name, noted)

    def of_answer():  # before, "Planning …" may be drawn
        return [name for name, words in sent if "of clearance everywhere" in words]

    types(operator, "0.9, 0.9", "5, 3")
    until(lambda: "add_line_segments" in of_answer())
    assert of_answer()[0] == "flush"


def test_who_waits_for_a_plan_sees_where_it_will_lead_and_no_old_path(operator, monkeypatch):
    operator.plans((0.9, 0.9, 0.0), (5.4, 3.4, 0.0))
    until(lambda: path_on_screen(operator) is not None)
    client, go = operator.page.desk.link.client, threading.Event()
    plan = client.plan
    monkeypatch.setattr(client, "plan", lambda *args, **more: (go.wait(60), plan(*args, **more))[1])
    types(operator, "0.9, 0.9", "5, 3")
    try:
        operator.sees("Planning …")
        until(lambda: operator.page.plans.paths.drawn == ())
    finally:
        go.set()
    until(lambda: path_on_screen(operator) is not None)
    np.testing.assert_allclose(path_on_screen(operator)[-1, :2], (5, 3), atol=1e-6)


def test_methods_are_compared_and_what_is_not_proven_says_so(operator):
    operator.plans((0.9, 0.9, 0.0), (5.4, 3.4, 0.0))
    operator.sees("of clearance everywhere")
    operator.presses("obstacle")
    operator.clicks((2.7, 1.9, 0.0))  # single_gpdf's way leads through it
    operator.presses("Compare the methods")
    rows = operator.web.get_by_role("row")
    until(lambda: rows.filter(has_text="dual_gpdf").filter(has_text="OK").count() == 1)
    assert rows.filter(has_text="prm").count() == rows.filter(has_text="astar").count() == 1
    assert rows.filter(has_text="single_gpdf").filter(has_text="UNCERTIFIED").count() == 1
    operator.sees("Dashed: do not follow it")
    operator.choose("Method", "single_gpdf")
    operator.sees("Not proven: do not follow it")


def same(path, other):
    return path is not None and path.shape == other.shape and np.allclose(path, other)


def test_a_dropped_obstacle_turns_the_path_aside_until_it_is_removed(operator):
    operator.plans((0.9, 0.9, 0.0), (5.4, 3.4, 0.0))
    operator.sees("of clearance everywhere")
    free = path_on_screen(operator)
    middle = free[np.abs(free[:, 0] - 2.0).argmin()]
    operator.presses("obstacle")
    operator.clicks(middle)
    until(lambda: path_on_screen(operator) is not None and not np.array_equal(path_on_screen(operator), free))
    beside = path_on_screen(operator)
    assert np.hypot(*(beside - middle)[:, :2].T).min() > 0.3 + AGENTS["human"].radius  # both radii
    operator.sees("Dropped obstacles")
    operator.clicks((4.6, 1.0, 0.0))
    drops = operator.page.plans.drops
    until(lambda: len(drops.obstacles) == 2 and operator.page.panel.plan.drops.chosen.value == list(drops.obstacles)[1])
    operator.presses("Remove it")
    until(lambda: len(operator.page.plans.drops.obstacles) == 1)
    operator.presses("Remove all")
    until(lambda: same(path_on_screen(operator), free))
    assert not operator.page.panel.plan.drops.folder.visible


def test_who_is_on_the_way_is_shown_until_nothing_is_heard(operator, service):
    with Client.connect(service.endpoint) as client:

        def say():
            pose = PoseMessage(position=[2.0, 1.5, 0.0], heading=0.5, stamp=time.time())
            cue = CueMessage(action=CueAction.GO, direction=0.0, urgency=0.0, distance=4.2, stamp=time.time())
            client.session.put(f"{keys.POSE}/anna", encode(pose))
            client.session.put(f"{keys.CUE}/anna", encode(cue))
            return operator.page.live.names == {"anna"}

        until(say)
    until(lambda: operator.page.live.names == frozenset())


def test_the_lowest_storey_is_shown_alone_and_the_others_by_their_height(operator):
    operator.opens("house")
    low, high = "0: floor at 0.0 m", f"1: floor at {STOREY:.1f} m"
    assert operator.page.panel.storey.value == low
    operator.tab("Map")
    operator.choose("Cloud by", "level")
    operator.settle()
    np.testing.assert_allclose(shade(operator, (3.0, 3.0, 0.0)), colours.pale(colours.LEVELS[0]), atol=12)
    operator.choose("Storey", high)
    operator.settle()
    np.testing.assert_allclose(shade(operator, (4.0, 4.0, STOREY)), colours.pale(colours.LEVELS[1]), atol=12)
    operator.tab("Plan")
    operator.plans((0.5, 2.0, STOREY), (4.5, 2.0, STOREY))
    operator.sees("of clearance everywhere")
    assert operator.page.plans.ends["goal"][2] == pytest.approx(STOREY, abs=0.05)
    operator.presses("Clear")
    operator.tab("Map")
    for label, value in (("Storey", "all of them"), ("Cloud by", "height")):
        operator.choose(label, value)


def test_a_scene_whose_scan_had_colours_is_shown_in_them(operator):
    assert AS_SCANNED not in operator.page.panel.map.colour.options  # the office had none
    operator.opens("house")
    operator.choose("Storey", f"0: floor at {0.0:.1f} m")
    operator.tab("Map")
    operator.choose("Cloud by", AS_SCANNED)
    operator.settle()
    np.testing.assert_allclose(shade(operator, (3.0, 3.0, 0.0)), PAINTED, atol=12)
    operator.sees("came without a colour")
    operator.choose("Cloud by", "height")
    operator.settle()
    np.testing.assert_allclose(shade(operator, (3.0, 3.0, 0.0)), colours.SEEN, atol=12)
    assert operator.errors == []


def test_storeys_are_pulled_apart_with_all_that_stands_on_them(operator):
    operator.opens("house")
    assert not operator.page.panel.apart.visible
    operator.choose("Storey", "all of them")
    until(lambda: operator.page.panel.apart.visible)
    types(operator, f"0.5, 2.0, {STOREY}", f"4.5, 2.0, {STOREY}")
    until(lambda: path_on_screen(operator) is not None)
    frame = operator.page.desk.frame
    operator.page.panel.apart.value = 3.0
    until(lambda: frame.apart == 3.0 and not operator.page.panel.work.content)
    operator.settle()
    assert frame.to_page(np.array([4.0, 4.0, STOREY]))[2] == pytest.approx(STOREY + 3.0, abs=0.05)
    assert shade(operator, (4.0, 4.0, STOREY)).min() > 150  # pale ground where it is drawn now
    operator.presses("start")
    operator.clicks((4.0, 4.0, STOREY))
    until(lambda: operator.page.plans.ends["start"][0] > 3.0)
    np.testing.assert_allclose(operator.page.plans.ends["start"], (4.0, 4.0, STOREY), atol=0.2)  # a flat ray
    operator.page.panel.apart.value = 0.0
    until(lambda: frame.apart == 0.0)
    assert operator.errors == []


def test_each_browser_has_a_page_of_its_own(operator, browser):
    operator.plans((0.9, 0.9, 0.0), (5.4, 3.4, 0.0))
    operator.sees("of clearance everywhere")
    with browser.new_context() as context:
        other = context.new_page()
        other.goto(operator.web.url)
        other.get_by_text("Click the ground:").wait_for()
        until(lambda: len(operator.pages.open) == 2)
        assert operator.pages.open[1].plans.ends == {"start": None, "goal": None}
        operator.pages.open[1].plans.leave()
        assert path_on_screen(operator) is not None
    until(lambda: len(operator.pages.open) == 1)


def types(operator, start, goal):
    for name, text in (("Start", start), ("Goal", goal)):
        field = operator.web.get_by_text(name, exact=True).locator("xpath=following::input[1]")
        field.fill(text)
        until(lambda name=name, text=text: operator.page.panel.plan.typed[name.lower()].value == text)
    operator.presses("Take what is typed")


def test_start_and_goal_can_be_typed_and_be_names(operator, service):
    with Client.connect(service.endpoint) as client:
        client.set_place("office", "door", [5.4, 3.4, 0.0])
    types(operator, "0.9, 0.9", "door")
    operator.sees("of clearance everywhere")
    until(lambda: path_on_screen(operator) is not None)
    np.testing.assert_allclose(path_on_screen(operator)[[0, -1], :2], [(0.9, 0.9), (5.4, 3.4)], atol=0.05)
    types(operator, "0.9, 0.9", "nowhere at all")
    operator.sees("nowhere at all")


def test_what_is_typed_after_clear_stays_though_a_plan_is_still_made(operator):
    going, go = threading.Event(), threading.Event()
    operator.page.desk.plans.do("plan", lambda: (going.set(), go.wait(60)))
    assert going.wait(30)
    try:
        operator.presses("Clear")
        operator.web.wait_for_timeout(500)
        types(operator, "0.9, 0.9", "5, 3")
    finally:
        go.set()
    ends = operator.page.plans.ends
    until(lambda: ends["goal"] is not None and np.allclose([*ends["start"][:2], *ends["goal"][:2]], (0.9, 0.9, 5, 3)))
    until(lambda: path_on_screen(operator) is not None)


def test_what_is_typed_before_the_chosen_scene_is_there_is_planned_in_it(operator):
    """Marks in the frame of the scene before, and a path that was cleared when the scene came, were seen."""
    operator.plans((0.9, 0.9, 0.0), (5.4, 3.4, 0.0))
    going, go = threading.Event(), threading.Event()
    operator.page.desk.maps.do("wait", lambda: (going.set(), go.wait(60)))
    assert going.wait(30)
    try:
        operator.choose("Scene", "house")
        until(lambda: operator.page.plans.ends["start"] is None)
        types(operator, "1, 2.4, 0", "6, 2.4, 0")
        operator.web.wait_for_timeout(500)
    finally:
        go.set()
    until(lambda: operator.page.scenes.shown[0] == "house" and path_on_screen(operator) is not None)
    np.testing.assert_allclose(path_on_screen(operator)[[0, -1], :2], [(1, 2.4), (6, 2.4)], atol=0.05)
    assert operator.page.panel.plan.typed["goal"].value == "6.00, 2.40, 0.00"


def test_a_refusal_is_a_card_with_a_button_that_takes_the_nearest_place(operator):
    operator.plans((0.9, 0.9, 0.0), (2.7, 0.45, 0.0))
    card = operator.web.get_by_role("alert").filter(has_text="No path: GOAL_OCCUPIED")
    card.wait_for()
    operator.web.get_by_role("button", name=re.compile("Take the nearest goal")).click()
    operator.sees("of clearance everywhere")
    assert card.count() == 0


def test_another_body_gets_another_answer(operator):
    operator.plans(*ONTO_THE_STEP)
    operator.sees("of clearance everywhere")
    assert path_on_screen(operator)[:, 2].max() > 0.3
    operator.choose("Body", "roomba")
    operator.sees("No path: ")
    until(lambda: path_on_screen(operator) is None)


def test_a_body_with_measures_of_its_own(operator):
    operator.plans(*ONTO_THE_STEP)
    operator.sees("of clearance everywhere")
    operator.web.get_by_text("Its measures").click()
    height = operator.web.get_by_label("Highest step [m]")
    height.fill("0.1")
    height.press("Enter")
    operator.sees("No path: ")
    until(lambda: operator.web.get_by_label("Body", exact=True).input_value() == "own")
    assert operator.page.desk.body.wire["max_step"] == 0.1
    operator.presses("Compare the bodies")
    rows = operator.web.get_by_role("row")
    until(lambda: rows.filter(has_text="human").filter(has_text="OK").count() == 1)
    until(lambda: rows.filter(has_text="own").count() == 1)
    assert rows.filter(has_text="own").filter(has_text="OK").count() == 0
    operator.web.get_by_text("Its measures").click()


def test_no_path_is_said_in_words(operator):
    operator.plans((0.9, 0.9, 0.0), (2.7, 0.45, 0.0))
    operator.sees("GOAL_OCCUPIED")
    assert path_on_screen(operator) is None


def test_a_service_that_is_killed_is_shown_and_found_again(operator, service):
    operator.plans((0.9, 0.9, 0.0), (5.4, 3.4, 0.0))
    operator.sees("of clearance everywhere")
    service.kill()
    operator.sees("Service lost")
    operator.presses("Plan")
    operator.sees("There is no service at")
    service.start()
    operator.sees("Connected to")
    operator.presses("Plan")
    operator.sees("of clearance everywhere")


def test_layers_and_slices_are_drawn(operator):
    operator.tab("Map")
    for name in ("What stops the body", "Where it fits"):
        operator.web.get_by_label(name).click()
    until(lambda: {"obstacles", "leaves"} <= operator.page.map.layers.drawn)
    operator.choose("Slice", "distance to obstacles (d_o)")
    operator.sees("a line each")
    operator.settle()
    picture = operator.picture()
    near, far = operator.around(picture, (0.3, 0.15, 0.6)), operator.around(picture, (2.5, 1.9, 0.6))
    assert far[..., 1].mean() > near[..., 1].mean() + 40  # viridis: its green rises from near to far
    operator.web.get_by_label("Cloud", exact=True).click()
    until(lambda: "cloud" not in operator.page.map.layers.drawn)
    for name in ("Cloud", "What stops the body", "Where it fits"):
        operator.web.get_by_label(name).first.click()
    operator.choose("Slice", "none")
    until(lambda: operator.page.map.layers.drawn == {"cloud", "ground"})


def test_a_scene_is_loaded_from_the_page(operator, service):
    made = SCENES["cluttered_office"](np.random.default_rng(0), spacing=0.06)
    label = made.ground.astype(int)
    np.savez(service.folder / "more.npz", xyz=made.points, label=label, classes=np.array(["other", "ground"]))
    operator.tab("Load")
    name, file = (operator.web.locator(f"input[value='{text}']") for text in ("office", "office.ply"))
    file.fill("more.npz")
    name.last.fill("more")
    until(lambda: (operator.page.panel.load.name.value, operator.page.panel.load.file.value) == ("more", "more.npz"))
    operator.presses("Load the file")
    until(lambda: operator.page.scenes.shown[0] == "more")
    assert operator.page.panel.scene.value == "more"
    operator.tab("Load")
    with operator.web.expect_file_chooser() as chooser:
        operator.presses("Send a cloud from here …")
    operator.page.panel.load.name.value = "sent"
    chooser.value.set_files(service.folder / "more.npz")
    until(lambda: operator.page.scenes.shown[0] == "sent")
    assert operator.page.scenes.facts["sent"]["digest"] == operator.page.scenes.facts["more"]["digest"]


def test_a_log_is_stepped_through(operator, service):
    operator.plans((0.9, 0.9, 0.0), (5.4, 3.4, 0.0))
    operator.sees("of clearance everywhere")
    first = path_on_screen(operator)
    operator.plans(*ONTO_THE_STEP)
    until(lambda: path_on_screen(operator) is not None and not np.array_equal(path_on_screen(operator), first))
    service.stop()
    log = max((service.folder / "log").glob("*.mcap"), key=lambda path: path.stat().st_mtime)
    service.start()
    operator.sees("Connected to")
    operator.tab("Log")
    with operator.web.expect_file_chooser() as chooser:
        operator.presses("Open a log (.mcap) …")
    chooser.value.set_files(log)
    operator.sees(r"1 of \d+")
    count = len(operator.page.logs.recorded)
    assert count >= 2
    for _ in range(count - 1):
        operator.presses("on")
    operator.sees(f"{count} of {count}")
    until(lambda: path_on_screen(operator) is not None and path_on_screen(operator)[:, 2].max() > 0.3)
    operator.presses("back")
    operator.sees(f"{count - 1} of {count}")
    until(lambda: np.array_equal(path_on_screen(operator), first))


def test_the_laser_scanned_office(operator, service, scan):
    shutil.copy(scan("cluttered_office_tls_1cm.npz"), service.folder / "laser.npz")
    with Client.connect(service.endpoint) as client:
        client.load_scene("laser", "laser.npz")
    operator.tab("Load")
    operator.presses("Look for scenes again")
    until(lambda: "laser" in operator.page.scenes.facts)
    operator.opens("laser")
    operator.tab("Plan")
    operator.plans((6.6, 9.2, 0.545), (9.9, 14.1, 0.545))
    operator.sees("of clearance everywhere")
    assert operator.errors == []
