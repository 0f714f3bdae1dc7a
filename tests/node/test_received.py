"""Why a received series is no scan: in words that stand on the status page, beside its description and UID."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydicom.dataset import Dataset

from ronnaplan.ct import catalogue
from ronnaplan.ct.folders import blobs_below
from ronnaplan.ct.scratch import Scratch
from ronnaplan.documents.fiducials import Source
from ronnaplan.errors import InputError
from ronnaplan.node.received import patient_received, read_received
from tests.ct.makers import FRAME, SERIES, STUDY, Change, write_series


def bare(made: Dataset, k: int) -> None:
    del made.RescaleSlope


def cut(made: Dataset, k: int) -> None:
    if k == 1:
        made.PixelData = made.PixelData[:-20]


def of_two_scans(made: Dataset, k: int) -> None:
    made.AcquisitionNumber = 1 + k // 4
    made.ImagePositionPatient = [0, 0, k % 4 + 0.3 * (k // 4)]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            bare,
            "8 of 8 files: it has no rescale slope and intercept, so its values are not Hounsfield units; "
            "export it again",
        ),
        (cut, "1 of 8 files (001): it declares 160 bytes of pixels but holds 140; copy it again"),
        (of_two_scans, "it holds 2 scans of different acquisitions; send each as a series of its own"),
    ],
)
def test_why_a_series_is_no_scan_is_told_without_its_folder_and_uid(
    tmp_path: Path, change: Change, reason: str
) -> None:
    folder = write_series(tmp_path / "1.2.3.1" / "1.2.3.2", 8, change)
    with Scratch(tmp_path) as scratch, pytest.raises(InputError) as refusal:
        read_received(folder, scratch)
    assert str(refusal.value) == reason


@pytest.mark.filterwarnings("ignore:The number of PN components:UserWarning")
def test_why_no_patient_is_told_is_said_without_folder_and_options_of_commands(tmp_path: Path) -> None:
    """The status page told an operator to leave out --ct."""

    def change(made: Dataset, k: int) -> None:
        made.PatientName = "Doe=Jane=J=D"

    folder = write_series(tmp_path / "1.2.3.1" / "1.2.3.2", 4, change)
    source = Source(study_instance_uid=STUDY, series_instance_uid=SERIES, frame_of_reference_uid=FRAME)
    with pytest.raises(InputError, match=r"^the PatientName of 000 cannot be copied .*; correct its header$"):
        patient_received(folder, source, print)


def test_a_refused_series_is_looked_through_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 10,000 slices each look takes seconds."""
    folder = write_series(tmp_path / "1.2.3.1" / "1.2.3.2", 8, bare)
    looked: list[Path] = []

    def below(path: Path, *given: Any) -> Any:
        looked.append(path)
        return blobs_below(path, *given)

    monkeypatch.setattr(catalogue, "blobs_below", below)
    with Scratch(tmp_path) as scratch, pytest.raises(InputError):
        read_received(folder, scratch)
    assert looked == [folder]
