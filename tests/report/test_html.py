"""The page's pieces: what a user typed cannot become markup, and the page needs no other file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from typing import Any

import hypothesis.strategies as st
import pytest
from hypothesis import given

from ronnaplan.report.html import RIGHT_TO_LEFT, box, element, page, picture, section, table, unseen
from ronnaplan.text import isolated
from tests.planner.browser import looking, needs_browser

HOSTILE = '<script>alert("x")</script>&amp;'


class Reader(HTMLParser):
    """Collects tags and text as a browser would."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


def read(html: str) -> Reader:
    reader = Reader()
    reader.feed(html)
    reader.close()
    return reader


@given(st.text(st.characters(exclude_categories=["Cs", "Cc"])))
def test_any_text_arrives_as_that_text(text: str) -> None:
    reader = read(element("p", text))
    assert reader.tags == ["p", *["bdi"] * len(RIGHT_TO_LEFT.findall(text))]
    assert reader.text == text


def test_hostile_text_is_text_wherever_it_stands() -> None:
    body = [
        table([HOSTILE, HOSTILE], [[HOSTILE, HOSTILE]]),
        table([], [[HOSTILE, HOSTILE]]),
        box("warnings", HOSTILE, [HOSTILE]),
        section(HOSTILE, []),
        picture(b"png", HOSTILE),
        unseen(HOSTILE, HOSTILE),
    ]
    reader = read(page(HOSTILE, body))
    assert "script" not in reader.tags
    assert reader.text.count(HOSTILE) == 12


def test_no_header_of_a_table_is_empty() -> None:
    """A screen reader would say one for nothing."""
    told = table(("", "value"), [("length", "3 mm")])
    assert "<th></th>" not in told
    assert told.count("<th>") == 1


def test_a_failed_limit_stands_out() -> None:
    assert '<td class="fail">FAIL</td>' in table(["limit", ""], [["length", "FAIL"]])


@pytest.fixture(scope="module")
def looked() -> Iterator[Callable[..., Any]]:
    with looking() as look:
        yield look


def columns_hidden(shown: Any, width: int, columns: int) -> tuple[int, int]:
    """By how many pixels a page with a table of many columns is wider than its window, and the table than its room."""
    names = [f"column {n} mm" for n in range(columns)]
    shown.set_viewport_size({"width": width, "height": 800})
    shown.set_content(page("Report", [section("Part", [table(names, [names])])]))
    of_page = shown.evaluate("document.documentElement.scrollWidth - innerWidth")
    return of_page, shown.locator("table").evaluate("(table) => table.scrollWidth - table.clientWidth")


@needs_browser
def test_a_table_wider_than_its_page_is_scrolled_by_itself(looked: Callable[..., Any]) -> None:
    for width, columns, least, most in ((390, 8, 300, 2000), (1600, 8, 0, 0), (1600, 24, 300, 4000)):
        of_page, of_table = looked(columns_hidden, width, columns)
        assert of_page <= 0
        assert least <= of_table <= most


def beyond_the_window(shown: Any, width: int) -> tuple[int, int]:
    """By how many pixels a page of names without blanks is wider than its window, and its table than its room."""
    name = "left_anterior_hippocampus_of_the_second_plan_after_the_conference" * 2
    shown.set_viewport_size({"width": width, "height": 800})
    body = [
        box("warnings", name, [name]),
        table(["trajectory", "limits"], [[name, "11 kept"], ["right", "-"]]),
    ]
    shown.set_content(page(name, [element("h1", name), section(name, body)]))
    of_page = shown.evaluate("document.documentElement.scrollWidth - innerWidth")
    return of_page, shown.locator("table").evaluate("(table) => table.scrollWidth - table.clientWidth")


@needs_browser
@pytest.mark.parametrize("width", [390, 1280])
def test_a_name_without_blanks_is_broken_before_it_leaves_the_page(looked: Callable[..., Any], width: int) -> None:
    assert looked(beyond_the_window, width) == (0, 0)


def written_order(shown: Any, text: str) -> str:
    """The letters of a paragraph without blanks, as they stand from left to right in a browser."""
    shown.set_viewport_size({"width": 1280, "height": 800})
    shown.set_content(page("Report", [element("p", text)]))
    order: str = shown.evaluate("""() => {
        const walker = document.createTreeWalker(document.querySelector("p"), NodeFilter.SHOW_TEXT), letters = [];
        while (walker.nextNode()) for (const n of [...walker.currentNode.data].keys()) {
            const range = document.createRange();
            range.setStart(walker.currentNode, n);
            range.setEnd(walker.currentNode, n + 1);
            letters.push([range.getBoundingClientRect().left, walker.currentNode.data[n]]);
        }
        return letters.sort((one, other) => one[0] - other[0]).map((one) => one[1]).join("");
    }""")
    return order.replace(" ", "")


@needs_browser
@pytest.mark.parametrize("name", ["\u05e7\u05d3\u05de\u05d9 \u05e9\u05de\u05d0\u05dc", "\u062d\u0635\u064a\u0646"])
def test_the_number_behind_a_name_from_right_to_left_keeps_its_place_and_sign(
    looked: Callable[..., Any], name: str
) -> None:
    assert looked(written_order, f"distance to {name} -0.46 mm").endswith("-0.46mm")


@needs_browser
@pytest.mark.parametrize("between", ["-", "/", "_", "'", '"', " 2 ", " - "])
def test_the_words_of_a_name_from_right_to_left_keep_their_order(looked: Callable[..., Any], between: str) -> None:
    """The first stands at the right, whatever is between it and the next."""
    first, last = "\u05e9\u05de\u05d0\u05dc", "\u05e7\u05d3\u05de\u05d9"
    order = looked(written_order, f"distance to {first}{between}{last} -0.46 mm")
    assert order == f"distanceto{last[::-1]}{between.strip()}{first[::-1]}-0.46mm"


@needs_browser
def test_a_name_from_right_to_left_is_not_torn_at_its_brackets(looked: Callable[..., Any]) -> None:
    """Each bracket is drawn as the mirror image of itself, and keeps its place in the name."""
    first, last = "\u05e9\u05de\u05d0\u05dc", "\u05e7\u05d3\u05de\u05d9"
    order = looked(written_order, f"distance to {first} ({last} 2) -0.46 mm")
    assert order == f"distanceto)2{last[::-1]}({first[::-1]}-0.46mm"


@needs_browser
@pytest.mark.parametrize("inside", ["CT 2", "{1} (CT)", "{1} ({1} 2)", "[(2)]"])
def test_a_name_between_isolates_is_whole_whatever_it_has_in_brackets(
    looked: Callable[..., Any], inside: str
) -> None:
    first, last = "\u05e9\u05de\u05d0\u05dc", "\u05e7\u05d3\u05de\u05d9"
    name = f"{first} ({inside.format(first, last)})"
    order = (
        looked(written_order, f"distance to {isolated(name)} -0.46 mm").replace("\u2068", "").replace("\u2069", "")
    )
    assert order.startswith("distanceto")
    assert order.endswith(f"{first[::-1]}-0.46mm")  # its first word stands at its right


def test_brackets_of_the_sentence_stay_outside_a_name() -> None:
    assert element("p", "left (\u05e9\u05de, 0.4 mm)") == "<p>left (<bdi>\u05e9\u05de</bdi>, 0.4 mm)</p>"


def width_on_a_phone(tab: Any) -> int:
    """How many of its own pixels a page is laid out on by a browser whose screen has 390."""
    phone = tab.context.browser.new_context(viewport={"width": 390, "height": 844}, is_mobile=True)
    shown = phone.new_page()
    shown.set_content(page("Report", [element("p", "as large as on a screen")]))
    return int(shown.evaluate("innerWidth"))


@needs_browser
def test_a_phone_shows_the_page_as_wide_as_its_screen_and_no_smaller(looked: Callable[..., Any]) -> None:
    assert looked(width_on_a_phone) == 390
