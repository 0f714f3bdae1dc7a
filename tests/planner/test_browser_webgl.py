"""The 3-D view drawn by the browser: what is in it, turned, opened, and pictures instead where that cannot be."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.loops import apart
from tests.planner.browser import Planner, at_rest, chromium, eventually, needs_browser, opened, seen_at, value

pytestmark = needs_browser

SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
SMALL = 760, 560
"""A window in which a head is drawn, in software, by few pixels."""

IN_NO_TIME, SLOWLY = "performance.now = () => 0", "let now = 0; performance.now = () => (now += 1000)"
"""Clocks by which a frame is drawn: how busy this machine is decides nothing."""

HERE = "document.querySelector('.rp-head').classList.contains('rp-drawn-here')"
DRAWN = (
    f"{HERE} && window.trame.state.get('things').length > 7 && window.trame.state.get('drawn_head').paths.length"
)
ASKED = ":is(.rp-open, .rp-again)"
LOSE = """document.querySelector('canvas[data-scene]').getContext('webgl2').getExtension('WEBGL_lose_context')
                  .loseContext()"""

HOLD = """() => {
  window.held = [];
  window.frame = window.requestAnimationFrame;
  window.requestAnimationFrame = (draw) => window.held.push(draw);
}"""
GO_ON = """() => {
  window.requestAnimationFrame = window.frame;
  window.held.forEach((draw) => window.requestAnimationFrame(draw));
}"""
"""Draw nothing for a while, and all of it then."""


def seen(page: Any) -> np.ndarray:
    """The 3-D view as it is on the screen (H, W, 3), once it stands still."""
    return at_rest(page, page.locator("canvas[data-scene]").screenshot)


def changed(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels that are not alike."""
    return float((np.abs(one - other).max(axis=2) > 25).mean())


def specks(shown: np.ndarray) -> int:
    """How many pixels of a picture are reddish amid grey ones: what lies behind a cut was seen through it there.

    Between reddish and grey lies a gap: skin in the shade, tinted by 20, is both, as the processor rounds.
    """
    tinted = shown[..., 2] - shown[..., 0] > 30
    grey = (np.ptp(shown, axis=2) <= 10) & (shown.min(axis=2) > 40)
    about = [np.roll(grey, by, axis=axis) for axis in (0, 1) for by in (-1, 1)]
    return int((tinted & np.all(about, axis=0)).sum())


def test_the_browser_draws_turns_and_opens_the_head_and_gets_pictures_where_it_cannot(shared: Planner) -> None:
    apart(look, shared.url)


def look(url: str) -> None:
    with chromium(*SOFTWARE) as browser:
        page = opened(browser, url, *SMALL, IN_NO_TIME)
        faults: list[str] = []
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.wait_for_function(DRAWN)
        eventually(page, lambda: seen(page).max() > 150)
        first = seen(page)
        asked = [url for url in page.requested if "/things/" in url]
        assert len(asked) < len(value(page, "things")) / 2, "one by one hundreds of things took many seconds"
        assert not value(page, "picture_head")
        ask_again_for_what_did_not_come(page, first)
        show_a_scan_that_comes_late_only_where_it_is_still_asked_for(page, first)
        ask_twice_for_what_is_slow(page)
        see_nothing_through_cuts(page)
        whole = turn(page, first)
        show_bone(page, whole)
        click_the_cube_in_small_windows(page)
        open_the_corner(page, whole)
        page.evaluate(LOSE)
        page.wait_for_function("window.trame.state.get('picture_head')")
        eventually(page, lambda: not page.evaluate(HERE) and not value(page, "look")["opened"])
        assert sum("/volume" in url for url in page.requested) == 2, "the scan is sent once, after it did not come"
        assert faults == []
        page.close()
        time_it_anew(opened(browser, url, *SMALL, SLOWLY))


def ask_again_for_what_did_not_come(page: Any, first: np.ndarray) -> None:
    """Things whose fetch a changed network had cut off were not shown until something else changed."""
    for lost in (lambda route: route.abort(), lambda route: route.fulfill(status=502)):
        page.route("**/things/*", lost, times=1)
        page.select_option("#shown-as", "skull")
        eventually(page, lambda: changed(seen(page), first) > 0.05)
        page.select_option("#shown-as", "skin")
        eventually(page, lambda: changed(seen(page), first) < 0.01)


def show_a_scan_that_comes_late_only_where_it_is_still_asked_for(page: Any, first: np.ndarray) -> None:
    """One that did not come was not asked for again; one that came late stood in the place of the surface."""
    held: list[Any] = []
    page.route("**/volume", lambda route: held.append(route))
    for wanted in ("bone", "soft tissue", "skin"):
        page.select_option("#shown-as", wanted)
        page.wait_for_function(f"window.trame.state.get('look').shown_as === '{wanted}'")
    eventually(page, lambda: bool(held))
    held[0].abort()
    eventually(page, lambda: len(held) == 2)
    with page.expect_response("**/volume"):
        held[1].continue_()
    assert changed(seen(page), first) < 0.01


def see_nothing_through_cuts(page: Any) -> None:
    """One of a hundred pixels of a cut showed what lies behind it: white points, as of lime in a brain."""
    page.set_viewport_size({"width": 1000, "height": 700})  # where the point was seen
    page.select_option("#shown-as", "soft tissue")
    page.wait_for_function("window.trame.state.get('volume').table")
    page.select_option("#opened", "corner")
    eventually(page, lambda: len(value(page, "eye")["planes"]) == 3)
    eventually(page, lambda: specks(seen(page)) == 0)  # once it is drawn whole
    page.select_option("#shown-as", "skin")
    eventually(page, lambda: any(one["name"] == "skin" for one in value(page, "things")))
    for _ in range(4):  # to where a point of the skin was seen where two cuts meet
        page.press("svg[data-view=head]", "ArrowRight")
    eventually(page, lambda: specks(seen(page)) == 0)  # once it is drawn whole
    page.select_option("#opened", "")
    page.set_viewport_size({"width": SMALL[0], "height": SMALL[1]})


def turn(page: Any, first: np.ndarray) -> np.ndarray:
    """Turn the head, and look at its front; return how it is seen there."""
    page.mouse.move(*seen_at(page, "head", (-0.7, 0.6)))
    page.mouse.down()
    page.mouse.move(*seen_at(page, "head", (-0.4, 0.6)), steps=3)
    page.mouse.up()
    eventually(page, lambda: changed(seen(page), first) > 0.05)
    page.click(".rp-cube >> text=A")
    eventually(page, lambda: is_from_the_front(page))
    return seen(page)


def is_from_the_front(page: Any) -> bool:
    return np.allclose(np.array(value(page, "eye")["axes"][6:]), [0, -1, 0], atol=1e-6)


def click_the_cube_in_small_windows(page: Any) -> None:
    """What is asked about the head, or to draw it, has room beside the cube; it lay over it."""
    page.evaluate(HOLD)  # drawn in software at each of these sizes, a head takes ten times as long
    for width, height in ((1366, 768), (1000, 700), (860, 600), SMALL):
        page.set_viewport_size({"width": width, "height": height})
        asked, cube = (page.locator(f"{which} >> visible=true").bounding_box() for which in (ASKED, ".rp-cube"))
        assert asked["x"] + asked["width"] <= cube["x"]
        page.click(".rp-cube >> text=A", trial=True)  # nothing lies over it
    page.evaluate(GO_ON)
    page.press("svg[data-view=head]", "ArrowRight")
    eventually(page, lambda: not is_from_the_front(page))
    page.click(".rp-cube >> text=A")
    eventually(page, lambda: is_from_the_front(page))


def show_bone(page: Any, whole: np.ndarray) -> None:
    """Draw the whole scan in the place of the surface, as dense as is asked for, and cut."""
    page.select_option("#shown-as", "bone")
    page.wait_for_function("window.trame.state.get('volume').table")
    assert all(one["name"] not in ("skin", "skull") for one in value(page, "things"))
    eventually(page, lambda: changed(seen(page), whole) > 0.05)
    dense = value(page, "volume")["table"]
    page.locator("#strength").fill("-2")
    eventually(page, lambda: value(page, "volume")["table"] != dense)
    page.select_option("#opened", "sagittal")
    eventually(page, lambda: len(value(page, "eye")["planes"]) == 1)
    page.select_option("#shown-as", "skin")
    eventually(page, lambda: any(one["name"] == "skin" for one in value(page, "things")))


def open_the_corner(page: Any, whole: np.ndarray) -> None:
    """Take the corner before the crosshair away; what is gone is not picked."""
    page.select_option("#opened", "corner")
    eventually(page, lambda: len(value(page, "eye")["planes"]) == 3)
    eventually(page, lambda: changed(seen(page), whole) > 0.05)
    corner, way = np.array(value(page, "eye")["corner"]), np.array(value(page, "eye")["way"])
    page.mouse.click(*seen_at(page, "head", (0.0, -0.2)))
    eventually(page, lambda: value(page, "eye")["corner"] != corner.tolist())
    picked = np.array(value(page, "eye")["corner"])
    assert ((picked - corner) * way).min() < 0.6  # nothing that was taken away is picked


def ask_twice_for_what_is_slow(page: Any) -> None:
    """A scan that was too slow to draw whole is timed whenever it is asked for; it held up the page."""
    page.evaluate("() => { let now = 0; performance.now = () => (now += 1000); }")
    page.evaluate(
        """() => { window.slow = 0; const ask = window.trame.trigger;
          window.trame.trigger = (name, given) => {
            window.slow += name === "volume_is_slow";
            return ask(name, given); }; }"""
    )
    for times in (1, 2):
        page.select_option("#shown-as", "soft tissue")
        page.wait_for_function(f"window.slow === {times}")
        eventually(page, lambda: value(page, "look")["shown_as"] == "skin")
    page.evaluate(IN_NO_TIME)


def time_it_anew(page: Any) -> None:
    """A browser that was slow gets pictures, until it is found to be quick."""
    page.wait_for_function("document.querySelector('canvas[data-scene]').hidden")
    page.wait_for_selector(".rp-head canvas[data-picture]", state="visible")
    click_the_cube_in_small_windows(page)
    page.click("text=draw in this browser")
    page.wait_for_selector("#news >> text=still takes 1000 ms a frame")
    page.evaluate(IN_NO_TIME)  # what kept the machine busy is done
    page.click("text=draw in this browser")
    page.wait_for_function(f"{HERE} && !window.trame.state.get('picture_head')")
    eventually(page, lambda: seen(page).max() > 150)
    page.wait_for_selector(".rp-again", state="hidden")
