import threading
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.ct import Limits, VolumeFlag, find_series, read_ct
from ronnaplan.ct.reader import in_parallel, read_series
from ronnaplan.ct.slices import SliceImage
from ronnaplan.errors import InputError
from tests.ct.makers import FRAME, SERIES, STUDY, dataset, pattern, save, write_series


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
    note = tmp_path / "a.txt"
    note.write_text("no image")
    with pytest.raises(InputError, match=r"/a\.txt holds no DICOM series \(it is [^()]*\); give a folder"):
        read_ct(note)
    with pytest.raises(InputError, match=r"holds no DICOM series \(a\.txt: it is [^()]*\); give a folder"):
        read_ct(tmp_path)
    note.unlink()
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
    found = find_series(tmp_path)
    assert [series.key for series in found.usable] == [SERIES]
    assert any("localizer" in series.problems[0] for series in found.series if not series.is_usable)
    assert read_ct(tmp_path).voxels_hu.shape == (4, 8, 10)


def test_a_series_beyond_the_memory_limit_is_refused_before_memory_is_taken(tmp_path: Path) -> None:
    write_series(tmp_path)
    with pytest.raises(InputError, match=r"the volume needs .* GiB but the limit is"):
        read_ct(tmp_path, limits=Limits(volume_bytes=600))


def test_ctrl_c_stops_the_read_at_once_and_leaves_no_thread_and_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[int] = []

    def interrupted(image: SliceImage, *_: object) -> None:
        begun.append(image.frame)
        raise KeyboardInterrupt

    write_series(tmp_path, 60)
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.setattr("ronnaplan.ct.reader.read_slice", interrupted)
    with pytest.raises(KeyboardInterrupt):
        read_ct(tmp_path)
    assert len(begun) < 60
    assert sorted(tmp_path.rglob("*")) == before
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("ThreadPool")]


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 100, 1003])
@pytest.mark.parametrize("threads", ["1", "2", "8"])
def test_each_slice_is_worked_at_once_and_in_runs(
    count: int, threads: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", threads)
    worked: list[int] = []
    shares: list[float] = []
    in_parallel(worked.append, count, shares.append)
    assert sorted(worked) == list(range(count))
    assert shares == [pytest.approx((number + 1) / count) for number in range(count)]


def test_peak_memory_stays_below_1_3_times_the_voxels(tmp_path: Path) -> None:
    for k in range(40):
        save(dataset(k, stored=np.full((256, 256), k, np.int16)), tmp_path / f"{k:02d}")
    read_ct(tmp_path)  # whatever is imported on first use
    tracemalloc.start()
    volume = read_ct(tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.3 * volume.voxels_hu.nbytes


def test_progress_is_shown_on_standard_error_only_on_a_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    read_ct(write_series(tmp_path), progress=True)
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")


def test_a_localizer_named_by_its_uid_is_refused_with_the_reason(tmp_path: Path) -> None:
    write_series(tmp_path, 1, lambda made, k: setattr(made, "ImageType", ["ORIGINAL", "PRIMARY", "LOCALIZER"]))
    (listed,) = find_series(tmp_path).series
    with pytest.raises(InputError, match="is not a usable CT: a localizer"):
        read_ct(tmp_path, SERIES)
    with pytest.raises(InputError, match="is not a usable CT: a localizer"):
        read_series(listed)
