"""An image beside the CT may be an MR, whose values have no unit; for a CT it is never taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydicom.dataset import Dataset
from pydicom.uid import MRImageStorage

from ronnaplan.ct import read_ct
from ronnaplan.ct.reader import read_other_image
from ronnaplan.errors import InputError
from tests.ct.makers import pattern, write_series
from tests.ct.test_images import VOXELS, changed


def as_mr(made: Dataset, k: int) -> None:
    made.Modality, made.SOPClassUID = "MR", MRImageStorage
    made.file_meta.MediaStorageSOPClassUID = MRImageStorage
    del made.RescaleSlope, made.RescaleIntercept


def test_an_mr_is_read_as_it_is_stored_and_where_it_lies(tmp_path: Path) -> None:
    folder = write_series(tmp_path, change=as_mr)
    with pytest.raises(InputError, match="the modality is MR, not CT"):
        read_ct(folder)
    found = read_other_image(folder)
    assert found.source.modality == "MR"
    np.testing.assert_array_equal(found.voxels_hu, [pattern(k) for k in range(4)])
    assert found.grid.positions_mm(np.array([[3.0, 0.0, 0.0]]))[0] == pytest.approx([-10, -20, 36])


def test_an_mr_of_another_class_and_what_is_no_slice_are_refused(tmp_path: Path) -> None:
    def spectrum(made: Dataset, k: int) -> None:
        as_mr(made, k)
        made.SOPClassUID = "1.2.840.10008.5.1.4.1.1.4.2"

    with pytest.raises(InputError, match="is not an MR image"):
        read_other_image(write_series(tmp_path / "spectrum", change=spectrum))

    def twice(made: Dataset, k: int) -> None:
        as_mr(made, k)
        made.ImagePositionPatient = [-10, -20, 30 + 2 * (k % 2)]

    with pytest.raises(InputError, match="no usable"):
        read_other_image(write_series(tmp_path / "echoes", change=twice))


@pytest.mark.parametrize(
    ("name", "before", "told"),
    [
        ("head.nrrd", b"kinds:", b"DICOM_0008_0060_Modality:=MR\n"),
        ("head.mha", b"ElementDataFile", b"Modality = MET_MOD_MR\n"),
    ],
)
def test_an_image_file_that_says_to_be_an_mr_is_taken_as_one(
    name: str, before: bytes, told: bytes, tmp_path: Path
) -> None:
    path = changed(tmp_path / name, before, told + before)
    with pytest.raises(InputError, match="its modality is MR, not CT"):
        read_ct(path)
    found = read_other_image(path)
    assert found.source.modality == "MR"
    assert found.voxels_hu.shape == VOXELS.shape
