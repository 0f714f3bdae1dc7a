"""The quality report says what a case holds, warnings first, and refuses what does not belong together."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ronnaplan import __version__
from ronnaplan.case.folder import Case, CaseFiles, read_case
from ronnaplan.documents.plan import write_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.report.pdf import find_browser, print_pdf
from ronnaplan.report.quality import quality_report
from tests import cases


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return cases.write_case(tmp_path_factory.mktemp("case"))


@pytest.fixture(scope="module")
def case(folder: Path) -> Case:
    return read_case(CaseFiles.of_folder(folder), cases.volume)


@pytest.fixture(scope="module")
def html(case: Case) -> str:
    return quality_report(case)


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


def test_the_page_fetches_nothing(html: str) -> None:
    assert set(re.findall(r'(?:src|href)="([a-z]+):', html)) == {"data"}
    assert "http:" not in html
    assert "https:" not in html
    assert "<script" not in html


def test_a_marker_that_is_not_where_the_document_says_is_the_first_thing_on_the_page(case: Case) -> None:
    assert case.fiducials is not None
    first, *others = case.fiducials.fiducials
    x, y, z = first.center
    moved = first.model_copy(update={"center": (x + 0.4, y, z), "flags": ("cut",)})
    page = quality_report(
        replace(case, fiducials=case.fiducials.model_copy(update={"fiducials": (moved, *others)}))
    )
    assert page.index("marker F1 was found again 0.40 mm from its stated center") < page.index("<h2>")
    assert "marker F1: part of the marker lies outside the scan" in page
    assert "marker F2 was found" not in page
    assert "the registration has marker F1 at another place; register again" in page


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


def test_a_path_through_the_air_is_a_warning(case: Case) -> None:
    assert case.plan is not None
    stray = case.plan.edit("left", entry_mm=np.array([0.0, 0.0, 5000.0]))
    assert "trajectory left could not be judged: the entry of left" in quality_report(replace(case, plan=stray))


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


@pytest.mark.skipif(find_browser() is None, reason="no Chromium is installed to print a PDF with")
def test_the_page_is_printed_as_pdf(html: str) -> None:
    printed = print_pdf(html)
    assert printed.startswith(b"%PDF-")
    assert printed.count(b"/Subtype /Image") >= 1


def test_without_a_browser_a_pdf_is_refused_with_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ronnaplan.report.pdf.BROWSERS", ())
    with pytest.raises(InputError, match=r"write \.html instead"):
        print_pdf("<p>")
