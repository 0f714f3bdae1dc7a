"""A page over a bad line: whatever comes late, or not at all, it is whole in the end, and says what it waits for."""

from __future__ import annotations

import json
from typing import Any

from ronnaplan.documents.plan import change_plan, read_plan, write_plan
from tests.planner.browser import PATIENCE_MS, Planner, eventually, needs_browser, wait_until_whole

pytestmark = needs_browser


def test_nothing_that_comes_late_takes_the_place_of_the_page(page: Any) -> None:
    """A picture of waiting that comes after the page would be written over it: it is not asked for."""
    page.wait_for_timeout(500)
    assert not [url for url in page.requested if "loading" in url]
    assert page.title() == "ronnaplan"


def test_the_page_asks_no_launcher_where_its_socket_is(page: Any, kept: Planner) -> None:
    assert not [url for url in page.requested if "paraview" in url or "sessionURL" in url]
    assert page.url == kept.url


def test_a_page_whose_connection_fails_or_is_cut_goes_on_by_itself(browser: Any, kept: Planner) -> None:
    page, lines = browser.new_page(), []

    def meet(line: Any) -> None:
        lines.append(line)
        if len(lines) == 1:
            line.close()
        else:
            line.connect_to_server()

    page.set_default_timeout(PATIENCE_MS)
    page.route_web_socket("**/ws", meet)
    page.goto(kept.url)
    page.wait_for_selector("text=took no connection from this page")
    wait_until_whole(page)
    page.evaluate("window.before = true")
    lines[-1].close()
    page.wait_for_function("!window.before")
    wait_until_whole(page)
    assert len(lines) == 3
    assert not page.locator("#gone").is_visible()


def lines_of(page: Any) -> list[Any]:
    """The web sockets that a page opens from now on, to be closed."""
    lines: list[Any] = []

    def meet(line: Any) -> None:
        lines.append(line)
        line.connect_to_server()

    page.set_default_timeout(PATIENCE_MS)
    page.route_web_socket("**/ws", meet)
    return lines


ASKED = "**/planner_page/planner.css"
"""What a page asks for to know whether the planner answers."""


def test_a_planner_that_was_only_held_up_is_gone_on_with_and_half_a_number_is_never_entered(
    page: Any, kept: Planner
) -> None:
    """The notice takes the focus from the field that is typed in, by which a browser enters what stands there."""
    entered = kept.folder / "plan.json"
    before = entered.read_bytes()
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


def test_a_planner_that_ends_and_still_answers_has_no_page_loaded_anew(browser: Any, kept: Planner) -> None:
    """It closes its sockets first: a page loaded then would find nobody. The page's clock hardly goes meanwhile."""
    page, asked = browser.new_page(), []
    lines = lines_of(page)
    page.goto(kept.url)
    wait_until_whole(page)
    page.on("request", lambda request: asked.append(request.url))
    page.evaluate("window.before = true; let now = performance.now(); performance.now = () => (now += 0.001)")
    lines[-1].close()
    asked.clear()
    eventually(page, lambda: len([url for url in asked if url.endswith("planner.css")]) == 3)
    assert page.evaluate("window.before")
    page.evaluate("const later = performance.now() + 60000; performance.now = () => later")
    page.wait_for_function("!window.before")
    wait_until_whole(page)


LEFT_OVER = """if (window.name === "") {
  window.name = "loaded before";
  sessionStorage.setItem("ronnaplan: half typed", %s);
}"""
"""What a page of another case left in its tab, as the first page that is loaded in it finds it."""


def test_what_is_half_typed_as_the_connection_is_cut_is_typed_again_and_never_into_another_field(
    browser: Any, kept: Planner
) -> None:
    plan, page = kept.folder / "plan.json", browser.new_page()
    lines = lines_of(page)
    change_plan(plan, lambda plan: plan.edit("left", notes=""))
    before = plan.read_bytes()
    of_another = {"id": "notes", "owner": "left", "before": "", "text": "of another case", "scan": "another"}
    page.add_init_script(LEFT_OVER % json.dumps(json.dumps(of_another)))
    page.goto(kept.url)
    wait_until_whole(page)
    page.wait_for_function("document.querySelector('#notes').value === ''")
    assert page.evaluate("[window.name, sessionStorage.length]") == ["loaded before", 0]

    def cut() -> None:
        page.evaluate("window.before = true")
        lines[-1].close()
        page.wait_for_function("!window.before")
        wait_until_whole(page)

    page.locator("#notes").press("Control+a")
    page.keyboard.type("a way between the ves")
    cut()
    page.wait_for_function("document.activeElement.id === 'notes'")
    page.keyboard.type("sels")
    assert plan.read_bytes() == before
    page.keyboard.press("Tab")
    eventually(page, lambda: read_plan(plan).trajectories[0].notes == "a way between the vessels")
    page.locator("#entry-x").press("Control+a")
    page.keyboard.type("2")
    changed = read_plan(plan).edit("left", entry_mm=[31.0, -20.0, 84.0])
    page.route(ASKED, lambda route: route.abort())
    lines[-1].close()
    page.wait_for_selector("#gone")
    write_plan(plan, changed)
    page.unroute(ASKED)
    page.wait_for_selector("#gone", state="detached")
    wait_until_whole(page)
    eventually(page, lambda: page.input_value("#entry-x") == "31")


def test_a_page_whose_connection_was_cut_without_a_word_loads_itself_again(browser: Any, kept: Planner) -> None:
    page = browser.new_page()
    cut: list[bool] = []

    def meet(line: Any) -> None:
        server = line.connect_to_server()
        server.on_message(lambda message: None if cut else line.send(message))

    page.set_default_timeout(PATIENCE_MS)
    page.route_web_socket("**/ws", meet)
    page.goto(kept.url)
    wait_until_whole(page)
    page.evaluate("window.before = true")
    cut.append(True)
    page.keyboard.press("a")  # which is never answered
    page.route(ASKED, lambda route: route.abort())
    page.wait_for_selector("#gone")
    page.unroute(ASKED)
    page.evaluate("window.addEventListener('pagehide', () => sessionStorage.setItem('gone', '1'))")
    page.wait_for_function("!window.before && sessionStorage.getItem('gone')")
    assert page.evaluate("sessionStorage.getItem('ronnaplan: untaken')")
    cut.clear()
    page.reload()
    wait_until_whole(page)
    page.wait_for_selector("#message >> text=what was clicked or entered last, which may not have been taken")
    page.reload()
    wait_until_whole(page)
    assert not page.locator("#message").count()  # it is told once


def test_what_the_planner_has_not_answered_yet_is_said_until_it_has(browser: Any, kept: Planner) -> None:
    """Over a slow line a click shows nothing for as long: who clicks again would have it done twice."""
    page, held = browser.new_page(), []
    slow = False

    def meet(line: Any) -> None:
        server = line.connect_to_server()
        line.on_message(lambda message: held.append((server, message)) if slow else server.send(message))

    page.set_default_timeout(PATIENCE_MS)
    page.route_web_socket("**/ws", meet)
    page.goto(kept.url)
    wait_until_whole(page)
    waiting = page.locator("#unanswered")
    assert not waiting.text_content()
    slow = True
    page.keyboard.press("a")
    page.wait_for_selector("#unanswered >> text=not answered yet")
    slow = False
    for server, message in held:
        server.send(message)
    eventually(page, lambda: not waiting.text_content())
    assert page.evaluate("window.trame.state.get('look').adding") == "click the entry"
    page.keyboard.press("Escape")


def test_a_planner_that_hangs_is_told_of_before_it_is_given_up(page: Any) -> None:
    """It took three questions of 4 s each until a page said anything, whose planner did not answer."""
    page.route(ASKED, lambda route: None)
    page.wait_for_selector("#unanswered >> text=the planner does not answer yet")
    assert not page.locator("#gone").count()
    page.unroute(ASKED)
    eventually(page, lambda: not page.locator("#unanswered").text_content())


def test_what_takes_long_to_make_tells_for_how_long_and_is_made_once(page: Any) -> None:
    asked: list[Any] = []
    page.route("**/download/report.pdf", lambda route: asked.append(route))
    page.click(".rp-tab >> text=Files")
    made = page.locator("[data-download='report.pdf']")
    made.click()
    page.wait_for_selector("#making-seconds >> text=2 s")
    made.click()  # by who waits for long
    page.click(".rp-tab >> text=Markers")
    page.click(".rp-tab >> text=Files")
    page.wait_for_selector("#making >> text=report.pdf is being made")
    page.click(".rp-tab >> text=Markers")
    assert len(asked) == 1
    asked[0].fulfill(status=422, body="Chromium could not print the report")
    page.wait_for_selector("#message >> text=report.pdf: Chromium could not print the report")
    page.click(".rp-tab >> text=Files")
    made.click()  # it can be asked for again
    eventually(page, lambda: len(asked) == 2)
    asked[1].fulfill(status=422, body="nor now")
    page.wait_for_selector("#making >> text=report.pdf: nor now")
    page.unroute("**/download/report.pdf")
    page.click("#message >> text=dismiss")
