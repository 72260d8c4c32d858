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


@pytest.fixture
def on_a_phone(browser, service):
    """The page on a phone held upright, as the phone shows it and as it is here."""
    operator, port = Operator(browser, service.endpoint), free_port()
    gate = Gate("127.0.0.1", port, ("127.0.0.1", operator.server.get_port()), "t", front=front_page())
    with browser.new_context(viewport={"width": WIDTH, "height": HEIGHT}) as context:
        web = context.new_page()
        web.goto(f"http://127.0.0.1:{port}/?token=t")
        web.get_by_text("Connected to").wait_for()
        until(lambda: len(operator.pages.open) == 2 and "cloud" in operator.pages.open[1].map.layers.there)
        yield web, operator.pages.open[1]
    gate.close()
    operator.close()


@pytest.mark.slow
@pytest.mark.browser
def test_the_page_on_a_phone_has_a_map_and_names_for_a_screen_reader(on_a_phone):
    phone, page = on_a_phone
    assert phone.title() == "Plan a way · gpdf"
    for name, text in (("start", "0.9, 0.9"), ("goal", "50, 50")):
        phone.get_by_role("textbox", name=name.capitalize()).fill(text)
        until(lambda name=name, text=text: page.panel.plan.typed[name].value == text)
    phone.wait_for_function("document.querySelectorAll('canvas[aria-label]').length > 0")
    panel = phone.get_by_text("Connected to").locator("xpath=ancestor::*[contains(@style, 'fixed')]").bounding_box()
    assert (panel["x"], panel["width"]) == (0, WIDTH)
    assert panel["height"] <= 0.46 * HEIGHT
    phone.get_by_role("button", name="Take what is typed").click()
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
    phone, page = on_a_phone
    for name, text in (("start", "0.9, 0.9"), ("goal", "2.7, 0.45, 0")):
        phone.get_by_role("textbox", name=name.capitalize()).fill(text)
        until(lambda name=name, text=text: page.panel.plan.typed[name].value == text)
    phone.get_by_role("button", name="Take what is typed").click()
    card = phone.get_by_role("alert").filter(has_text="No path")
    card.wait_for()
    phone.locator(".mantine-Notification-closeButton").first.click()  # Chromium's, about drawing by software
    shown = """one => { const box = one.getBoundingClientRect(), x = box.x + box.width / 2;
        return [box.top + 4, box.bottom - 4].every(y => one.contains(document.elementFromPoint(x, y))); }"""
    until(lambda: card.evaluate(shown))
