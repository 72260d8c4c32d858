"""A link to the page opens scene, view and plan: what it says, and in two browsers."""

import msgspec
import numpy as np
import pytest
from driving import Operator, free_port, until
from gpdf_schemas import Array, Cylinder, MovingObstacle

from gpdf_service.types import AGENTS
from gpdf_service.viewer.front import front_page
from gpdf_service.viewer.gate import Gate
from gpdf_service.viewer.map_layers import View
from gpdf_service.viewer.panel import SHARE
from gpdf_service.viewer.sharing import KEY, MOST_BYTES, Shared

VIEW = View(shown=frozenset({"ground"}), colour="level", below=2.1, point_size=0.03, levels=frozenset({0, 2}))
POST = MovingObstacle(id="1", cylinder=Cylinder((1.0, 2.0, 0.0), 0.25, 1.8))
OWN = {key: getattr(AGENTS["spot"], key) for key in ("height", "width", "length", "max_step", "max_slope", "speed")}
OWN |= {"name": "own", "acceleration": 1.0, "turn_rate": 1.5, "discs": 4}
SHARED = Shared(
    "a house", VIEW, (1.0, -2.0, 3.5), (0.0, 0.0, 0.1), OWN, "astar", (0.5, 0.5, 0.0), (4.0, 4.5, 2.8), (POST,)
)


def test_a_link_says_what_was_put_into_it_in_letters_alone():
    link = SHARED.to_link()
    assert Shared.from_link(link) == SHARED
    assert all(letter.isalnum() or letter in "-_" for letter in link)  # no mail program ends the link before its end
    assert SHARED.body.discs == 4


@pytest.mark.parametrize(
    "link",
    [
        "?",
        "AAAA",
        SHARED.to_link()[:-9],
        "ü",
        "A" * 5,
        Shared("a", VIEW, (0.0, np.nan, 0.0), (0.0, 0.0, 0.0)).to_link(),
        Shared("a", VIEW, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), agent="nobody").to_link(),
        Shared("a", VIEW, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), agent={"height": 1.0}).to_link(),
        Shared("a", VIEW, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), agent=OWN | {"height": -1.0}).to_link(),
        Shared("a", VIEW, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), method="teleport").to_link(),
        Shared("a" * MOST_BYTES, VIEW, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)).to_link(),
    ],
)
def test_a_link_that_says_nothing_that_can_be_shown_is_refused_in_words(link):
    with pytest.raises(ValueError, match="The link of this page"):
        Shared.from_link(link)


def test_nothing_that_somebody_wrote_into_a_link_is_shown():
    mark = "<img src=x>"
    link = msgspec.structs.replace(
        SHARED, agent=OWN | {"name": mark}, obstacles=(MovingObstacle(id=mark, cylinder=POST.cylinder),)
    )
    shared = Shared.from_link(link.to_link())
    assert shared.body.name == "own"
    assert [one.id for one in shared.dropped] == ["1"]
    for bad in (msgspec.structs.replace(SHARED, agent=mark), msgspec.structs.replace(SHARED, method=mark)):
        with pytest.raises(ValueError, match="The link of this page") as refused:
            Shared.from_link(bad.to_link())
        assert mark not in str(refused.value)


@pytest.fixture
def door(browser, service):
    """The page through its gate, and a way to come to it in a browser of one's own."""
    operator, port, contexts = Operator(browser, service.endpoint), free_port(), []
    gate = Gate("127.0.0.1", port, ("127.0.0.1", operator.server.get_port()), "t", front=front_page())

    def come(link=""):
        context = browser.new_context(
            viewport={"width": 1100, "height": 600}, permissions=["clipboard-read", "clipboard-write"]
        )
        contexts.append(context)
        web, there = context.new_page(), len(operator.pages.open)
        web.goto(f"http://127.0.0.1:{port}/?token=t#{link}")
        until(lambda: len(operator.pages.open) == there + 1)
        page = operator.pages.open[-1]
        until(lambda: page.scenes.shown[0] and "cloud" in page.map.layers.there and not page.panel.work.content)
        return web, page

    yield come
    for context in contexts:
        context.close()
    gate.close()
    operator.close()


def link_in(web):
    return web.evaluate("location.hash.slice(1)")


def says(web, name, value):
    """Whether the address holds it, as it is now."""
    link = link_in(web)
    return bool(link) and getattr(Shared.from_link(link), name) == value


@pytest.mark.slow
@pytest.mark.browser
def test_another_browser_opens_scene_view_and_plan(door):
    web, page = door()
    until(lambda: says(web, "scene", "house") or says(web, "scene", "office"))
    page.scenes.turn_to("house", lambda: None)
    until(lambda: page.scenes.shown[0] == "house" and not page.panel.work.content)
    page.panel.storey.value = page.panel.storey.options[1]
    page.panel.map.colour.value = "level"
    page.panel.plan.method.value = "astar"
    page.desk.body.show(AGENTS["spot"])
    page.desk.browser.camera.position = (3.0, -4.0, 9.0)
    page.desk.browser.camera.look_at = (3.0, 2.0, 1.0)
    start, goal = (1.0, 2.0, 2.8), (4.5, 2.0, 2.8)
    page.desk.plans.do("plan", lambda: page.plans.open({"start": start, "goal": goal}, [POST_ABOVE, DUST]))
    until(lambda: page.plans.paths.shown is not None)
    until(lambda: says(web, "goal", goal) and says(web, "obstacles", (POST_ABOVE,)))
    web.wait_for_timeout(1000)  # the camera's last word
    link = link_in(web)

    other, same = door(link)
    until(lambda: same.plans.paths.shown is not None)
    assert same.scenes.shown == page.scenes.shown
    assert same.map.layers.view == page.map.layers.view
    assert same.desk.body.wire == "spot"
    assert list(same.plans.drops.obstacles.values()) == [POST_ABOVE]  # what came as points is in no link
    np.testing.assert_array_equal(same.plans.paths.shown.ground, page.plans.paths.shown.ground)
    np.testing.assert_allclose(same.desk.browser.camera.position, (3.0, -4.0, 9.0), atol=2e-3)
    np.testing.assert_allclose(same.desk.browser.camera.look_at, (3.0, 2.0, 1.0), atol=2e-3)
    told = Shared.from_link(link)
    until(lambda: all(says(other, name, getattr(told, name)) for name in SAME))  # and it goes on saying so


SAME = ("scene", "view", "agent", "method", "start", "goal", "obstacles")
POST_ABOVE = MovingObstacle(id="1", cylinder=Cylinder((2.5, 4.5, 2.8), 0.1, 1.8))
DUST = MovingObstacle(id="2", points=Array.pack(np.array([[3.0, 4.9, 3.0]])))


@pytest.mark.slow
@pytest.mark.browser
def test_a_reload_and_a_lost_connection_bring_the_page_back_as_it_was(door):
    web, page = door()
    page.scenes.turn_to("office", lambda: None)
    until(lambda: page.scenes.shown[0] == "office")
    ends = {"start": (0.9, 0.9, 0.0), "goal": (5.4, 3.4, 0.0)}
    page.desk.plans.do("plan", lambda: page.plans.open(ends, []))
    until(lambda: says(web, "goal", ends["goal"]))
    web.reload()
    web.get_by_text("of clearance everywhere").first.wait_for(timeout=120_000)
    until(lambda: says(web, "start", ends["start"]))
    web.get_by_role("button", name="Clear", exact=True).dispatch_event("click")
    until(lambda: says(web, "start", None))


@pytest.mark.slow
@pytest.mark.browser
def test_the_button_copies_the_address_and_a_bad_one_is_told(door):
    web, _ = door("AAAA")
    web.get_by_text("The link of this page cannot be read").first.wait_for()
    until(lambda: link_in(web) not in ("", "AAAA"))
    web.get_by_role("button", name=SHARE, exact=True).dispatch_event("click")
    web.get_by_text("Link to this page").first.wait_for()
    until(lambda: web.evaluate("navigator.clipboard.readText()") == web.url)
    assert KEY not in web.evaluate("Object.keys(localStorage).join()")  # it is nowhere but in the address
