"""The quality report says what a case holds, warnings first, and refuses what does not belong together."""

from __future__ import annotations

import base64
import errno
import hashlib
import json
import re
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan import __version__
from ronnaplan.case.folder import Case, CaseFiles, read_case
from ronnaplan.documents.plan import write_plan
from ronnaplan.documents.plan_measures import measures_document
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import FrameMismatchError, InputError, UnwrittenError
from ronnaplan.planning import Landmarks, Limits
from ronnaplan.planning.electrodes import ELECTRODES
from ronnaplan.report import path_part
from ronnaplan.report.html import STYLE, page, picture, section, table
from ronnaplan.report.marker_part import MarkerPicture
from ronnaplan.report.overview import View
from ronnaplan.report.pdf import find_browser, print_pdf
from ronnaplan.report.quality import quality_report
from ronnaplan.scene.shapes import ball
from ronnaplan.scene.things import Thing
from tests import cases
from tests.planner.browser import looking, needs_browser

A4_PT = (595.3, 841.9)

SEEN = View([Thing("path left", ball([10.0, 20.0, 30.0], 5.0), np.array([1.0, 0.5, 0.0]))], b"still")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return cases.write_case(tmp_path_factory.mktemp("case"))


@pytest.fixture(scope="module")
def case(folder: Path) -> Case:
    return read_case(CaseFiles.of_folder(folder), cases.volume)


@pytest.fixture(scope="module")
def html(case: Case) -> str:
    return quality_report(case)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cuts are not drawn: they say nothing of what is tested."""
    monkeypatch.setattr(path_part, "path_picture", lambda *_: b"")
    monkeypatch.setattr(MarkerPicture, "png", b"")


def test_every_marker_pair_and_trajectory_is_reported(html: str) -> None:
    for marker in cases.fiducials().fiducials:
        assert f"<td>{marker.label}</td><td>{marker.center[0]:.3f}</td>" in html
    for pair in cases.registration().pairs:
        assert f"<td>{pair.ct}</td><td>{pair.ots}</td><td>{pair.residual:.2f}</td>" in html
    assert f"{np.linalg.norm(cases.ENTRY_MM - cases.TARGET_MM):.2f} mm" in html
    assert "left: two cuts along the path" in html
    assert html.count("data:image/png;base64,") == len(cases.fiducials().fiducials) + 1


def test_the_expected_error_at_a_planned_end_is_that_of_the_registration(html: str) -> None:
    covariance = cases.registration().pose.point_covariances(cases.TARGET_MM[np.newaxis])[0]
    assert f"<td>left target</td><td>{np.sqrt(np.trace(covariance)):.3f}</td>" in html


def test_inputs_and_software_can_be_told_from_the_page(html: str, folder: Path) -> None:
    for name in ("fiducials.json", "registration.json", "plan.json"):
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() in html
    assert cases.volume().voxel_sha256 in html
    assert f"ronnaplan {__version__}" in html


def test_what_the_page_holds_for_programs_is_what_plan_check_writes_in_half_the_bytes(
    case: Case, html: str
) -> None:
    """Of hundreds of trajectories it was most of the page."""
    (held,) = re.findall('<div id="measures" hidden>(.*?)</div>', html, re.DOTALL)
    assert case.plan is not None
    measured = [judged.measures for judged in case.judgements if judged.measures is not None]
    verdicts = [verdict for judged in case.judgements for verdict in judged.verdicts]
    written = measures_document(case.plan, measured, verdicts)
    assert json.loads(unescape(held)) == json.loads(written)
    assert len(held) < 0.6 * len(written)


def test_the_page_has_a_main_part_for_screen_readers(html: str) -> None:
    assert html.index("<main>") < html.index("<h1>") < html.index("</main>")


def test_the_page_fetches_nothing(html: str) -> None:
    assert set(re.findall(r'(?:src|href)="([a-z]+):', html)) == {"data"}
    assert "http:" not in html
    assert "https:" not in html
    assert "<script" not in html
    assert "script-src" not in html


@pytest.mark.usefixtures("undrawn")
def test_the_head_is_turned_by_the_one_script_that_the_page_allows(case: Case) -> None:
    page = quality_report(case, "case <7>", SEEN)
    (run,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', page)
    assert f"script-src 'sha256-{base64.b64encode(hashlib.sha256(run.encode()).digest()).decode()}'" in policy
    assert "http:" not in page
    assert "https:" not in page
    assert base64.b64encode(SEEN.still_png).decode() in page
    (scene,) = re.findall(r'id="scene">(.*?)</script>', page, re.DOTALL)
    assert [thing["name"] for thing in json.loads(scene)["things"]] == ["path left"]
    assert "<h1>Quality report: case &lt;7&gt;</h1>" in page
    printed = quality_report(case, "", SEEN, turns=False)
    assert "<script" not in printed
    assert base64.b64encode(SEEN.still_png).decode() in printed


def test_page_one_tells_each_trajectory_in_a_line(case: Case, html: str) -> None:
    assert case.plan is not None
    measured = case.surroundings.judge(case.plan[0], case.plan).measures
    assert measured is not None
    assert measured.error is not None
    assert measured.planned_error is not None
    angles = f"{measured.arc.arc_deg:.1f}, {measured.arc.ring_deg:.1f}"
    errors = [f"{one.target_rms_mm:.2f}" for one in (measured.planned_error, measured.error)]
    cells = ["left", f"{measured.length_mm:.1f}", angles, "-", *errors, "9 kept"]
    row = "".join(f"<td>{cell}</td>" for cell in cells)
    assert html.index(row) < html.index("<h2>Scan</h2>")


@pytest.mark.usefixtures("undrawn")
def test_page_one_tells_where_the_ac_pc_frame_was_set(case: Case, html: str) -> None:
    assert "AC-PC frame" not in html
    assert case.plan is not None
    points = (np.array(place) for place in ([0.5, -12.0, 22.0], [0.5, 12.5, 22.0], [0.5, 0.0, 60.0]))
    set_now = replace(case, plan=case.plan.with_landmarks(Landmarks(*points)))
    assert (
        "AC-PC frame, LPS mm: AC 0.50, -12.00, 22.00; PC 0.50, 12.50, 22.00; midline 0.50, 0.00, 60.00. "
        "AC and PC are 24.5 mm apart."
    ) in quality_report(set_now)


def test_planned_and_registered_error_stand_beside_each_other(html: str) -> None:
    assert "<th>expected error</th><th>as planned</th><th>as registered</th>" in html


@pytest.mark.usefixtures("undrawn")
def test_contacts_are_listed_below_their_trajectory(case: Case) -> None:
    assert case.plan is not None
    chosen = case.plan.edit("left", electrode=ELECTRODES["Medtronic 3387"])
    page = quality_report(replace(case, plan=chosen))
    place = ", ".join(f"{value:.2f}" for value in chosen.trajectory("left").contacts_mm[3])
    assert f"<td>4</td><td>{place}</td>" in page
    assert "<td>contacts to metal</td>" in page


@pytest.mark.usefixtures("undrawn")
def test_broken_limits_stand_first_and_are_counted_on_page_one(case: Case) -> None:
    strict = replace(case, rules=replace(case.rules, limits=Limits(longest_path_mm=20.0)))
    page = quality_report(strict)
    assert '<td class="fail">FAIL: 1 of 10</td>' in page
    verdicts = page[page.index("held against limits") :]
    assert verdicts.index("FAIL") < verdicts.index("pass")


@pytest.mark.usefixtures("undrawn")
def test_pages_are_numbered_on_the_paper_asked_for(html: str, case: Case) -> None:
    assert "@page { size: A4;" in html
    assert 'content: "page " counter(page) " of " counter(pages)' in html
    hostile = quality_report(case, 'x" } </style><b>', paper="Letter")
    assert "@page { size: Letter;" in hostile
    assert hostile.count("</style>") == 1


def test_numbers_stay_whole_and_only_long_words_break() -> None:
    assert '<td class="long">' + "1.2.8" * 9 in table([], [("uid", "1.2.8" * 9)])
    assert "<td>-12.34, 5.67, 8.90</td>" in table([], [("place", "-12.34, 5.67, 8.90")])
    assert "td { overflow-wrap" not in STYLE
    told = table([], [("arc, ring", "106.2, 68.7", "at depth 15.3 mm", "the outer table of the skull is broken")])
    assert told.count("<td>") == 2  # numbers stay together, and with their unit
    assert told.count('<td class="text">') == 1
    assert "td { white-space: nowrap }" in STYLE
    assert "td.long { overflow-wrap: anywhere }" in STYLE


def test_the_report_ends_with_room_for_signatures(html: str) -> None:
    assert html.index("<h2>Inputs</h2>") < html.index("<h2>Signatures</h2>")
    assert "<td>checked by</td><td></td><td></td><td></td>" in html
    assert '<div class="whole"><section><h2>Inputs</h2>' in html
    assert "</table></div></div>\n" in html[html.index("<h2>Signatures</h2>") :]


@pytest.mark.usefixtures("undrawn")
def test_a_marker_that_is_not_where_the_document_says_is_the_first_thing_on_the_page(case: Case) -> None:
    assert case.fiducials is not None
    first, *others = case.fiducials.fiducials
    x, y, z = first.center
    moved = first.model_copy(update={"center": (x, y + 0.4, z), "flags": ("cut",)})
    page = quality_report(
        replace(case, fiducials=case.fiducials.model_copy(update={"fiducials": (moved, *others)}))
    )
    assert page.index("marker F1 was found again 0.40 mm from its stated center") < page.index("<h2>")
    assert "marker F1: part of the marker lies outside the scan" in page
    assert "marker F2 was found" not in page
    assert "the registration has marker F1 at another place; register again" in page


@pytest.mark.usefixtures("undrawn")
def test_a_refused_registration_is_a_warning_and_not_a_transform(case: Case) -> None:
    refused = cases.registration().model_copy(
        update={"status": "ambiguous", "reason": "two ways fit", "ots_from_ct": None, "covariance": None}
    )
    page = quality_report(replace(case, registration=refused))
    assert page.index("the registration is ambiguous: two ways fit") < page.index("<h2>")
    assert "pairing probability" not in page


def test_without_its_scan_a_case_is_reported_with_a_warning(folder: Path) -> None:
    case = read_case(CaseFiles.of_folder(folder), lambda: None)
    page = quality_report(case)
    assert "the scan is not at hand" in page
    assert "data:image/png" not in page
    assert f"<td>{np.linalg.norm(cases.ENTRY_MM - cases.TARGET_MM):.2f}</td>" in page


@pytest.mark.usefixtures("undrawn")
def test_a_path_through_the_air_is_a_warning(case: Case) -> None:
    assert case.plan is not None
    stray = case.plan.edit("left", entry_mm=np.array([0.0, 0.0, 5000.0]))
    page = quality_report(replace(case, plan=stray))
    assert "trajectory left could not be judged: the entry of left" in page
    told = page[page.index("<h3>left</h3>") :]
    assert told.startswith('<h3>left</h3><p class="fail">could not be judged: the entry of left')
    assert "<td>0.00, 0.00, 5000.00</td>" in told  # no empty heading
    assert '<td class="fail">not judged</td>' in page


def test_documents_of_another_scan_are_refused(tmp_path: Path) -> None:
    cases.write_case(tmp_path)
    plan = cases.plan()
    write_plan(tmp_path / "plan.json", replace(plan, source=replace(plan.source, frame_of_reference_uid="9.9")))
    with pytest.raises(FrameMismatchError, match=r"plan\.json is in frame"):
        read_case(CaseFiles.of_folder(tmp_path), lambda: None)
    source = cases.fiducials().source.model_copy(update={"voxel_sha256": "0" * 64})
    write_plan(tmp_path / "plan.json", plan)
    (tmp_path / "fiducials.json").write_text(to_json(cases.fiducials().model_copy(update={"source": source})))
    with pytest.raises(InputError, match="other voxels"):
        read_case(CaseFiles.of_folder(tmp_path), cases.volume)


def test_a_folder_without_documents_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds none of fiducials\.json"):
        read_case(CaseFiles.of_folder(tmp_path), lambda: None)
    with pytest.raises(InputError, match="is not a folder"):
        CaseFiles.of_folder(tmp_path / "nowhere")


@pytest.fixture(scope="module")
def printed(html: str) -> bytes:
    if find_browser() is None:
        pytest.skip("no Chromium is installed to print a PDF with")
    return print_pdf(html)


Pages = Callable[[str], int]


@pytest.fixture(scope="module")
def pages() -> Iterator[Pages]:
    """How many pages a report takes on paper: one browser prints them all, as `print_pdf` does with one for each."""
    with looking() as look:
        yield lambda report: look(count_pages, report)


def count_pages(tab: Any, report: str) -> int:
    tab.set_content(report)
    found: int = tab.pdf(prefer_css_page_size=True).count(b"/MediaBox")
    return found


@needs_browser
def test_a_path_with_an_electrode_of_many_contacts_takes_one_page(case: Case, html: str, pages: Pages) -> None:
    assert case.plan is not None
    chosen = case.plan.edit("left", electrode=ELECTRODES["DIXI D08-18AM"])
    assert pages(quality_report(replace(case, plan=chosen))) == pages(html)


@needs_browser
@pytest.mark.usefixtures("undrawn")
def test_names_of_many_letters_take_no_more_pages_and_stand_whole_above_their_measures(
    case: Case, pages: Pages
) -> None:
    """One filled page two with its row, another the page after that of a path that it is held against."""
    assert case.plan is not None
    left, counts = case.plan.trajectory("left"), []
    for names in (("left", "beside"), ("W" * 299 + "1", "W" * 299 + "2")):
        paths = tuple(
            replace(left, name=name, entry_mm=left.entry_mm + n, target_mm=left.target_mm + n)
            for n, name in enumerate(names)
        )
        report = quality_report(replace(case, plan=replace(case.plan, trajectories=paths)))
        assert all(f"<h3>{name}</h3>" in report for name in names)
        counts.append(pages(report))
    assert counts[0] == counts[1]
    assert f'<td class="long">{"W" * 30}\u2026{"W" * 28}2</td>' in report


@pytest.mark.usefixtures("undrawn")
def test_long_names_alike_at_both_ends_are_told_apart_in_every_table(case: Case) -> None:
    """By beginning and end alone, two rows of the overview and of the expected errors were called the same."""
    assert case.plan is not None
    left, names = case.plan.trajectory("left"), ["W" * 150 + n + "W" * 149 for n in "12"]
    paths = (left, *(replace(left, name=name, entry_mm=left.entry_mm + n) for n, name in enumerate(names, 1)))
    report = quality_report(replace(case, plan=replace(case.plan, trajectories=paths)))
    for name in names:
        for cell in (name, f"{name} entry", f"{name} target", f"distance to {name}"):
            assert re.search(rf"<t[dh][^>]*>{cell}</t[dh]>", report), cell[:20]


@needs_browser
def test_a_path_with_many_limits_and_contacts_takes_one_page(case: Case, html: str, pages: Pages) -> None:
    assert case.plan is not None
    chosen = case.plan.edit("left", electrode=ELECTRODES["Medtronic 3387"])
    report = quality_report(replace(case, plan=chosen))
    (limit,) = re.findall("<tr><td>path within the instrument</td>.*?</tr>", report)
    near = limit.replace("<td></td></tr>", '<td class="text">at depth 69.2 mm, at least 14.45</td></tr>')
    assert pages(report.replace(limit, 12 * limit + 10 * near)) == pages(html)


@needs_browser
def test_a_table_that_fits_on_a_page_is_not_cut_by_the_end_of_one(pages: Pages) -> None:
    """Beneath a picture the first row of a table stood at the end of a page, the others on the next."""
    robot = picture(b"", "the robot")  # a part without one is whole anyway
    large = table(["place", "x mm"], [[f"place {n}", f"{n}"] for n in range(23)])
    assert pages(page("Report", [section("Placement", [robot, *[large] * 3])])) == 3


def test_the_page_is_printed_as_pdf(printed: bytes) -> None:
    assert printed.startswith(b"%PDF-")
    assert printed.count(b"/Subtype /Image") >= 1
    boxes = re.findall(rb"/MediaBox \[0 0 ([0-9.]+) ([0-9.]+)\]", printed)
    assert [tuple(map(float, box)) for box in boxes] == [pytest.approx(A4_PT, abs=1.0)] * len(boxes)


def test_without_a_browser_a_pdf_is_refused_with_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ronnaplan.report.pdf.BROWSERS", ())
    with pytest.raises(InputError, match=r"write \.html instead"):
        print_pdf("<p>")


def test_a_browser_that_no_command_starts_is_found_where_it_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    browser = tmp_path / "Google Chrome"
    browser.touch(0o755)
    monkeypatch.setenv("APPLICATIONS", str(tmp_path))
    monkeypatch.setattr("ronnaplan.report.pdf.BROWSERS", ("no-such-command", "$APPLICATIONS/Google Chrome"))
    assert find_browser() == str(browser)


def test_a_report_is_printed_where_who_asks_looks_after_what_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker of the node that was killed left it, with what it tells of a patient, in the system's folder."""
    printed_in: list[Path] = []

    def printing(browser: str, html: str, folder: Path) -> bytes:
        printed_in.append(folder)
        return b"%PDF-1.4 %%EOF"

    monkeypatch.setattr("ronnaplan.report.pdf.find_browser", lambda: "chromium")
    monkeypatch.setattr("ronnaplan.report.pdf._printed", printing)
    print_pdf("<p>", tmp_path)
    assert [folder.parent for folder in printed_in] == [tmp_path]
    assert not list(tmp_path.iterdir())


class Browser:
    """What stands for a browser's process, which prints as it is told and ends well."""

    pid = 1

    def __init__(self, command: list[str], **_: Any) -> None:
        target = next(part for part in command if part.startswith("--print-to-pdf="))
        self.print(Path(target.partition("=")[2]))

    def print(self, target: Path) -> None:
        """Print nothing."""

    def wait(self, seconds: float | None = None) -> int:
        """Return the exit status."""
        return 0


def test_a_browser_that_takes_too_long_is_told_as_such_and_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """It went on, and wrote what it keeps into the folder that was removed: Debian's begins by a script."""

    class Slow(Browser):
        def wait(self, seconds: float | None = None) -> int:
            if seconds is None:
                return -9
            raise subprocess.TimeoutExpired("chromium", seconds)

    ended: list[object] = []
    monkeypatch.setattr("ronnaplan.report.pdf.find_browser", lambda: "chromium")
    monkeypatch.setattr("ronnaplan.report.pdf.subprocess.Popen", Slow)
    monkeypatch.setattr("ronnaplan.report.pdf.kill_all", ended.append)
    with pytest.raises(
        InputError, match=r"had not printed the report after 120 s, .*; try again, or write \.html"
    ):
        print_pdf("<p>")
    assert [type(one) for one in ended] == [Slow]


def test_a_browser_that_fails_has_printed_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing(Browser):
        def print(self, target: Path) -> None:
            target.write_bytes(b"%PDF-1.4 %%EOF")

        def wait(self, seconds: float | None = None) -> int:
            return 1

    monkeypatch.setattr("ronnaplan.report.pdf.find_browser", lambda: "chromium")
    monkeypatch.setattr("ronnaplan.report.pdf.subprocess.Popen", Failing)
    with pytest.raises(InputError, match=r"chromium could not print the report"):
        print_pdf("<p>")


@pytest.mark.parametrize("left", [b"", b"%PDF-1.4\n1 0 obj"])
def test_half_a_pdf_is_none_and_that_the_disk_is_full_is_told(
    monkeypatch: pytest.MonkeyPatch, left: bytes
) -> None:
    """Of a full disk Chromium tells nobody: its exit status is 0."""

    class Half(Browser):
        def print(self, target: Path) -> None:
            with target.open("wb") as stream:
                stream.write(left)

    def full(path: Path, content: bytes) -> None:
        assert len(content) > 2**20
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("ronnaplan.report.pdf.find_browser", lambda: "chromium")
    monkeypatch.setattr("ronnaplan.report.pdf.subprocess.Popen", Half)
    with pytest.raises(
        InputError, match=r"chromium could not print the report; write \.html and print that"
    ) as told:
        print_pdf("<p>")
    assert not isinstance(told.value, UnwrittenError)
    monkeypatch.setattr("ronnaplan.report.pdf.subprocess.Popen", Browser)
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(UnwrittenError, match=r"no room to print the report in .*; make room there"):
        print_pdf("<p>")
