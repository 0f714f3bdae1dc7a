"""A case is the documents of one scan, and nothing else is taken for one."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from ronnaplan.case.folder import Case, CaseFiles, read_case, read_scan
from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.plan import write_plan
from ronnaplan.errors import FrameMismatchError, InputError
from tests import cases
from tests.documents.placements import placed


def test_everything_in_the_folder_and_what_was_stated_is_read_and_told(tmp_path: Path) -> None:
    cases.write_case(tmp_path)
    (tmp_path / "limits.json").write_text(
        json.dumps({"format": "ronnaplan.limits", "version": 1, "tolerance_mm": 1.5})
    )
    maps = [cases.write_label_map(tmp_path / hand / "vessel.nii.gz") for hand in ("one", "other")]
    case = read_case(CaseFiles.of_folder(tmp_path), cases.volume, no_go=maps)
    assert case.rules.limits.tolerance_mm == 1.5
    assert [name.partition(" (")[0] for name in case.no_go] == ["vessel", "vessel"], (
        "one name, two regions: both count"
    )
    assert len(case.surroundings.obstacles) == 1 + 2 + len(cases.fiducials().fiducials)
    assert [name for name, _ in case.hashes] == [
        *("fiducials.json", "registration.json", "plan.json", "limits.json", "vessel.nii.gz", "vessel.nii.gz"),
        "voxels of the scan",
    ]


def test_without_the_scan_nothing_is_measured(tmp_path: Path) -> None:
    files = CaseFiles.of_folder(cases.write_case(tmp_path))
    case = read_case(files, lambda: None)
    assert case.expected.registered is not None
    with pytest.raises(InputError, match="the scan is not at hand"):
        _ = case.surroundings
    with pytest.raises(InputError, match="a label map was given but not the scan"):
        read_case(files, lambda: None, no_go=[tmp_path / "vessel.nii.gz"])


def test_where_no_frame_is_named_only_the_voxels_tell_one_scan() -> None:
    volume, plan = cases.volume(), cases.plan()
    nameless = replace(volume, source=replace(volume.source, frame_of_reference_uid=None))
    bare = replace(plan, source=nameless.source, trajectories=(), history=())
    assert Case(nameless, bare).plan is bare
    for voxels in (None, "0" * 64):
        with pytest.raises(FrameMismatchError, match="voxels differ or are not stated"):
            Case(nameless, replace(bare, voxel_sha256=voxels))


@pytest.mark.parametrize("document", ["plan", "registration"])
def test_a_scan_that_was_replaced_under_its_uids_is_not_the_documents(document: str) -> None:
    volume = cases.volume()
    case = Case(volume, cases.plan()) if document == "plan" else Case(volume, registration=cases.registration())
    replaced = replace(volume, voxels_hu=volume.voxels_hu + 1)
    with pytest.raises(InputError, match=rf"{document}\.json is of other voxels than the scan"):
        replace(case, volume=replaced)
    elsewhere = replace(replaced, source=replace(volume.source, series_instance_uid="1.2.3"))
    assert replace(case, volume=elsewhere).volume is elsewhere, "another series of the frame is the same head"


def test_a_document_of_another_scan_is_told_by_the_file_that_was_named(tmp_path: Path) -> None:
    plan = tmp_path / "other.json"
    write_plan(plan, cases.plan())
    volume = cases.volume()
    elsewhere = replace(volume, source=replace(volume.source, frame_of_reference_uid="1.9"))
    with pytest.raises(FrameMismatchError, match=f"^{re.escape(str(plan))} is in frame"):
        read_case(CaseFiles(plan), lambda: elsewhere)


def test_documents_of_a_replaced_series_do_not_go_together_on_another_scan_of_the_frame_either() -> None:
    volume = cases.volume()
    elsewhere = replace(volume, source=replace(volume.source, series_instance_uid="1.2.3"))
    older = replace(cases.plan(), voxel_sha256="0" * 64)
    assert Case(elsewhere, older).plan is older
    with pytest.raises(InputError, match=r"plan\.json is of other voxels than registration\.json"):
        Case(elsewhere, older, registration=cases.registration())


def test_a_scan_that_lies_in_the_case_and_cannot_be_used_is_not_passed_over(tmp_path: Path) -> None:
    assert read_scan(tmp_path, None, None) is None
    (tmp_path / "ct").mkdir()
    whole = next(cases.CT.glob("*.dcm")).read_bytes()
    (tmp_path / "ct" / "1.dcm").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"ct holds no usable CT series"):
        read_scan(tmp_path, None, None)


def test_a_placement_of_another_scan_is_refused() -> None:
    other = placed(source=Source(frame_of_reference_uid="1.2.3.4", voxel_sha256="0" * 64))
    with pytest.raises(FrameMismatchError, match=r"placement\.json is in frame"):
        Case(plan=cases.plan(), placement=other)
