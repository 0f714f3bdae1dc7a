"""A page over a bad line: whatever comes late, or not at all, it is whole in the end, and says what it waits for."""

from __future__ import annotations

from typing import Any

from tests.planner.browser import PATIENCE_MS, Planner, needs_browser, opened, wait_until_whole

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
