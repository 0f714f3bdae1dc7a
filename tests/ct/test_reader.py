from pathlib import Path

import numpy as np
import pytest

from ronnaplan.ct import VolumeFlag, catalogue, read_ct
from ronnaplan.errors import InputError
from tests.ct.makers import FRAME, SERIES, STUDY, pattern, write_series


def test_a_folder_becomes_a_volume_in_hu_with_every_voxel_in_its_place(tmp_path: Path) -> None:
    volume = read_ct(write_series(tmp_path))
    assert volume.voxels_hu.dtype == np.int16
    assert np.array_equal(volume.voxels_hu, np.stack([pattern(k) for k in range(4)]) - 1024)
    assert np.allclose(volume.grid.positions_mm(np.array([3, 2, 1.0])), [-10 + 0.75, -20 + 1.0, 36])
    assert (volume.source.study_instance_uid, volume.source.series_instance_uid) == (STUDY, SERIES)
    assert volume.frame.uid == FRAME
    assert volume.flags == ()


def test_two_usable_series_are_listed_and_asked_for(tmp_path: Path) -> None:
    write_series(tmp_path / "a")
    write_series(tmp_path / "b", change=lambda made, k: setattr(made, "SeriesInstanceUID", "1.2.3.9"))
    with pytest.raises(InputError, match=r"2 usable series.*1\.2\.3\.2 \(4 slices, 'Head 2 mm'\).*1\.2\.3\.9"):
        read_ct(tmp_path)
    assert read_ct(tmp_path, "1.2.3.9").source.series_instance_uid == "1.2.3.9"


def test_an_unknown_series_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"holds no series 9\.9; there is {SERIES}"):
        read_ct(write_series(tmp_path), "9.9")


def test_a_missing_folder_an_empty_folder_and_a_folder_without_ct_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no file or folder"):
        read_ct(tmp_path / "nowhere")
    with pytest.raises(InputError, match="holds no DICOM series"):
        read_ct(tmp_path)
    write_series(tmp_path, change=lambda made, k: setattr(made, "Modality", "MR"))
    with pytest.raises(InputError, match=r"no usable CT series .*the modality is MR"):
        read_ct(tmp_path)


def test_slices_are_sorted_by_position_whatever_the_order_of_files(tmp_path: Path) -> None:
    heights = [36, 30, 34, 32]
    write_series(tmp_path, change=lambda made, k: setattr(made, "ImagePositionPatient", [0, 0, heights[k]]))
    volume = read_ct(tmp_path)
    assert volume.grid.slice_positions_mm.tolist() == [30, 32, 34, 36]
    assert np.array_equal(volume.voxels_hu[0], pattern(1) - 1024)


def test_a_missing_slice_is_read_exactly_and_flagged(tmp_path: Path) -> None:
    heights = [30, 32, 36, 38]
    write_series(tmp_path, change=lambda made, k: setattr(made, "ImagePositionPatient", [0, 0, heights[k]]))
    volume = read_ct(tmp_path)
    assert volume.grid.slice_positions_mm.tolist() == heights
    assert VolumeFlag.MISSING_SLICE in volume.flags


def test_a_mixed_folder_is_sorted_out(tmp_path: Path) -> None:
    write_series(tmp_path)

    def localizer(made: object, k: int) -> None:
        made.SeriesInstanceUID, made.ImageType = "1.2.3.7", ["ORIGINAL", "PRIMARY", "LOCALIZER"]  # type: ignore[attr-defined]

    write_series(tmp_path / "scout", 1, localizer)
    (tmp_path / "notes.txt").write_text("not an image")
    found = catalogue(tmp_path)
    assert [series.key for series in found.usable] == [SERIES]
    assert any("localizer" in series.problems[0] for series in found.series if not series.is_usable)
    assert read_ct(tmp_path).voxels_hu.shape == (4, 8, 10)
