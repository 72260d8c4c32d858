"""The page through its gate, as people open it: title, a phone's layout, and what a screen reader is told."""

from pathlib import Path

import pytest
from driving import Operator, free_port, until

from gpdf_service.viewer.front import TITLE, front_page
from gpdf_service.viewer.gate import Gate

AXE = Path(__file__).parent.parent / "phone" / "node_modules" / "axe-core" / "axe.min.js"
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
WIDTH, HEIGHT = 390, 844


def test_the_first_file_is_visers_with_our_title():
    assert TITLE not in front_page().decode()
    assert b"<title>Plan a way" in front_page()


def press(web, start, goal):
    """Type both places and press, all within one frame: as when the browser draws while a person types."""
    web.wait_for_selector("input[aria-label=Goal]", state="attached")
    web.evaluate(
        """([start, goal]) => {
          const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
          let wait = Promise.resolve();
          for (const [name, text] of [['Start', start], ['Goal', goal]]) wait = wait.then(() => {
            const field = [...document.querySelectorAll('input')].find(one => one.getAttribute('aria-label') === name);
            set.call(field, text);
            field.dispatchEvent(new Event('input', {bubbles: true}));
          });
          return wait.then(() => [...document.querySelectorAll('button')]
              .find(one => one.textContent === 'Take what is typed').click());
        }""",
        [start, goal],
    )


@pytest.fixture
def on_a_phone(browser, service):
    """The page on a phone held upright, as the phone shows it and as it is here."""
    operator, port = Operator(browser, service.endpoint), free_port()
    gate = Gate("127.0.0.1", port, ("127.0.0.1", operator.server.get_port()), "t", front=front_page())
    with browser.new_context(viewport={"width": WIDTH, "height": HEIGHT}) as context:
        web = context.new_page()
        web.goto(f"http://127.0.0.1:{port}/?token=t")
        web.get_by_text("Connected to").wait_for(timeout=120_000)  # drawn by software, beside other work
        until(lambda: len(operator.pages.open) == 2 and "cloud" in operator.pages.open[1].map.layers.there)
        yield web, operator.pages.open[1]
    gate.close()
    operator.close()


@pytest.mark.slow
@pytest.mark.browser
def test_the_page_on_a_phone_has_a_map_and_names_for_a_screen_reader(on_a_phone):
    phone, _ = on_a_phone
    assert phone.title() == "Plan a way · gpdf"
    phone.wait_for_function("document.querySelectorAll('canvas[aria-label]').length > 0")
    panel = phone.get_by_text("Connected to").locator("xpath=ancestor::*[contains(@style, 'fixed')]").bounding_box()
    assert (panel["x"], panel["width"]) == (0, WIDTH)
    assert panel["height"] <= 0.46 * HEIGHT
    press(phone, "0.9, 0.9", "50, 50")
    phone.get_by_role("alert").filter(has_text="No path").wait_for()
    if not AXE.is_file():
        pytest.skip("needs tests/phone/node_modules: make test-page")
    phone.locator(".mantine-Notification-closeButton").first.click()  # Chromium's, about drawing by software
    phone.wait_for_function("!document.querySelector('.mantine-Notification-root')")
    phone.add_script_tag(path=str(AXE))
    found = phone.evaluate("rules => axe.run({runOnly: rules})", RULES)
    print(f"axe-core: {len(found['passes'])} rules passed, {len(found['violations'])} violated")
    assert [(one["id"], [node["html"] for node in one["nodes"]]) for one in found["violations"]] == []


@pytest.mark.slow
@pytest.mark.browser
def test_on_a_phone_a_refusal_comes_into_sight(on_a_phone):
    phone, _ = on_a_phone
    press(phone, "0.9, 0.9", "2.7, 0.45, 0")
    card = phone.get_by_role("alert").filter(has_text="No path")
    card.wait_for()
    phone.locator(".mantine-Notification-closeButton").first.click()  # Chromium's, about drawing by software
    shown = """one => { const box = one.getBoundingClientRect(), x = box.x + box.width / 2;
        return [box.top + 4, box.bottom - 4].every(y => one.contains(document.elementFromPoint(x, y))); }"""
    until(lambda: card.evaluate(shown))


@pytest.mark.slow
@pytest.mark.browser
def test_all_that_is_typed_and_pressed_within_a_frame_arrives(on_a_phone):
    phone, page = on_a_phone
    for start in ("0.9, 0.9", "1.2, 0.9", "0.9, 1.2"):  # what is dropped stays as it was before
        press(phone, start, "5, 3")
        until(lambda start=start: ends(page) == [start, "5, 3"])


def ends(page):
    return ["" if at is None else f"{at[0]:g}, {at[1]:g}" for at in page.plans.ends.values()]


@pytest.mark.slow
@pytest.mark.browser
def test_who_typed_one_end_alone_is_told_to_give_the_other(on_a_phone):
    phone, _ = on_a_phone
    press(phone, "0.9, 0.9", "")
    phone.get_by_text("Type the goal, too, or click the ground there.").wait_for()
