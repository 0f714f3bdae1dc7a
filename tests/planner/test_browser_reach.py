"""A page over a bad line: whatever comes late, or not at all, it is whole in the end, and says what it waits for."""

from __future__ import annotations

from typing import Any

from ronnaplan.documents.plan import read_plan
from tests.planner.browser import PATIENCE_MS, Planner, eventually, needs_browser, opened, wait_until_whole

pytestmark = needs_browser


def test_nothing_that_comes_late_takes_the_place_of_the_page(browser: Any, shared: Planner) -> None:
    """A picture of waiting that comes after the page would be written over it: it is not asked for."""
    page = opened(browser, shared.url)
    page.wait_for_timeout(500)
    assert not [url for url in page.requested if "loading" in url]
    assert page.title() == "ronnaplan"


def test_the_page_asks_no_launcher_where_its_socket_is(browser: Any, shared: Planner) -> None:
    page = opened(browser, shared.url)
    assert not [url for url in page.requested if "paraview" in url or "sessionURL" in url]
    assert page.url == shared.url


def test_a_page_whose_connection_fails_or_is_cut_goes_on_by_itself(browser: Any, shared: Planner) -> None:
    page, lines = browser.new_page(), []

    def meet(line: Any) -> None:
        lines.append(line)
        if len(lines) == 1:
            line.close()
        else:
            line.connect_to_server()

    page.set_default_timeout(PATIENCE_MS)
    page.route_web_socket("**/ws", meet)
    page.goto(shared.url)
    page.wait_for_selector("text=took no connection from this page")
    wait_until_whole(page)
    page.evaluate("window.before = true")
    lines[-1].close()
    page.wait_for_function("!window.before")
    wait_until_whole(page)
    assert len(lines) == 3
    assert not page.locator("#gone").is_visible()


ASKED = "**/planner_page/planner.css"
"""What a page asks for to know whether the planner answers."""


def test_a_planner_that_was_only_held_up_is_gone_on_with_and_half_a_number_is_never_entered(
    browser: Any, running: Planner
) -> None:
    """The notice takes the focus from the field that is typed in, by which a browser enters what stands there."""
    entered = running.folder / "plan.json"
    before = entered.read_bytes()
    page = opened(browser, running.url)
    page.evaluate("window.before = true")
    page.locator("#entry-x").press("Control+a")
    page.keyboard.type("2")
    page.route(ASKED, lambda route: route.abort())
    page.wait_for_selector("#gone >> text=only held up")
    page.unroute(ASKED)
    page.wait_for_selector("#gone", state="detached")
    page.keyboard.type("9")
    assert page.input_value("#entry-x") == "29"
    assert entered.read_bytes() == before
    page.keyboard.press("Enter")
    eventually(page, lambda: read_plan(entered).trajectories[0].entry_mm[0] == 29.0)
    page.locator("#notes").fill("what stands there is entered though nothing more is typed")
    page.route(ASKED, lambda route: route.abort())
    page.wait_for_selector("#gone")
    page.unroute(ASKED)
    page.wait_for_selector("#gone", state="detached")
    page.keyboard.press("Tab")
    eventually(page, lambda: read_plan(entered).trajectories[0].notes.startswith("what stands there"))
    assert page.evaluate("window.before")


def test_a_page_whose_connection_was_cut_without_a_word_loads_itself_again(browser: Any, shared: Planner) -> None:
    page = browser.new_page()
    cut: list[bool] = []

    def meet(line: Any) -> None:
        server = line.connect_to_server()
        server.on_message(lambda message: None if cut else line.send(message))

    page.set_default_timeout(PATIENCE_MS)
    page.route_web_socket("**/ws", meet)
    page.goto(shared.url)
    wait_until_whole(page)
    page.evaluate("window.before = true")
    cut.append(True)
    page.route(ASKED, lambda route: route.abort())
    page.wait_for_selector("#gone")
    page.unroute(ASKED)
    page.wait_for_function("!window.before")
    cut.clear()
    page.reload()
    wait_until_whole(page)
