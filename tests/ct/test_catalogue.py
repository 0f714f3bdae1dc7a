import re
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pydicom.data
import pytest
from pydicom import dcmread
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.uid import UID, ExplicitVRLittleEndian, generate_uid

from ronnaplan.cohort.places import Fetched
from ronnaplan.ct import VolumeFlag, find_series, read_ct
from ronnaplan.ct.catalogue import DICOMDIR_CLASS, read_instance
from ronnaplan.ct.files import DamagedError, Skipped
from ronnaplan.ct.limits import Limits
from ronnaplan.ct.summary import summarize
from ronnaplan.errors import InputError
from tests.ct.makers import SERIES, dataset, enhanced, pattern, save, write_series

DICOMDIR = Path(pydicom.data.__file__).parent / "test_files" / "dicomdirtests" / "DICOMDIR"


def test_a_dicomdir_stands_for_the_tree_it_indexes() -> None:
    by_index, by_folder = find_series(DICOMDIR), find_series(DICOMDIR.parent)
    assert [one.key for one in by_index.series] == [one.key for one in by_folder.series]
    assert {one.first.modality for one in by_index.series} >= {"CT", "MR", "CR"}
    assert any("an index" in one.reason for one in by_index.skipped)


def test_a_damaged_file_beside_a_series_is_named_and_flagged(tmp_path: Path) -> None:
    write_series(tmp_path)
    content = (tmp_path / "003").read_bytes()
    (tmp_path / "003").write_bytes(content[:300])
    found = find_series(tmp_path)
    assert [(one.name.endswith("003"), one.is_trouble) for one in found.skipped] == [(True, True)]
    assert found.skipped[0].reason.endswith("; copy it again")
    assert read_ct(tmp_path).voxels_hu.shape[0] == 3
    assert "could not be read" in read_ct(tmp_path).flags[-1]


def test_a_scan_that_was_taken_since_another_cannot_be_used_is_flagged(tmp_path: Path) -> None:
    """Of one damaged slice, the scan of another day was localized instead, without a word."""

    def of_another(made: Dataset, k: int) -> None:
        made.SeriesInstanceUID = "1.2.9"
        if k == 1:
            made.PixelData = made.PixelData[:-20]

    write_series(tmp_path, 12)
    write_series(tmp_path, 7, of_another, "other")
    assert read_ct(tmp_path).flags == (VolumeFlag.ONLY_USABLE,)
    assert read_ct(tmp_path, SERIES).flags == ()  # it was asked for
    (tmp_path / "other006").unlink()  # as few as are made to watch contrast come
    assert read_ct(tmp_path).flags == ()


def test_a_damaged_file_of_many_frames_counts_as_many_slices(tmp_path: Path) -> None:
    """It was one file, of which nothing was said beside a scan of twelve."""
    made = enhanced(12)
    made.SeriesInstanceUID = "1.2.9"
    save(made, tmp_path / "multi")
    (tmp_path / "multi").write_bytes((tmp_path / "multi").read_bytes()[:-100])
    assert read_ct(write_series(tmp_path, 12)).flags == (VolumeFlag.ONLY_USABLE,)


def test_an_empty_file_with_the_name_of_an_image_is_flagged(tmp_path: Path) -> None:
    write_series(tmp_path)
    (tmp_path / "notes.txt").touch()
    assert read_ct(tmp_path).flags == ()
    (tmp_path / "004.dcm").touch()
    assert read_ct(tmp_path).flags == (VolumeFlag.UNREADABLE_FILES,)


def test_what_macos_keeps_for_itself_is_no_failed_copy(tmp_path: Path) -> None:
    write_series(tmp_path)
    beside = b"\0\x05\x16\x07\0\x02\0\0Mac OS X        " + bytes(4072)
    for name in ("000", "004.dcm"):
        (tmp_path / f"._{name}").write_bytes(beside)
    (tmp_path / ".Spotlight-V100" / "Store-V2").mkdir(parents=True)
    (tmp_path / ".Spotlight-V100" / "Store-V2" / "journalExclusion").touch()
    assert read_ct(tmp_path).flags == ()


@pytest.mark.parametrize("name", ["head.hdr", "head.IMG", "head.gipl", "head.vtk", "head.mgz"])
def test_an_image_of_a_format_that_is_not_read_is_told_what_to_become(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(bytes(400))
    with pytest.raises(InputError, match="in a format that is not read; convert it to NIfTI, NRRD or MetaImage"):
        read_ct(tmp_path / name)


def test_a_file_cut_anywhere_before_its_series_uid_is_flagged(tmp_path: Path) -> None:
    write_series(tmp_path)
    content = (tmp_path / "003").read_bytes()
    for end in range(132, content.index(SERIES.encode()), 7):
        (tmp_path / "003").write_bytes(content[:end])
        assert [one.is_trouble for one in find_series(tmp_path).skipped] == [True], end


@pytest.mark.parametrize(
    ("name", "content", "is_flagged"),
    [
        ("004", b"", True),
        ("004.IMA", b"", True),
        ("CT.1.2.3.4", bytes(500), True),
        ("004.dcm.gz", b"packed", True),
        ("004.dcm.part", b"half", True),
        ("004", bytes(131) + b"1" + bytes(500), False),
        (".lock", b"", False),
        ("scan.raw", bytes(500), False),
    ],
)
def test_what_a_failed_copy_left_of_an_image_is_flagged(
    name: str, content: bytes, is_flagged: bool, tmp_path: Path
) -> None:
    write_series(tmp_path)
    (tmp_path / name).write_bytes(content)
    assert read_ct(tmp_path).flags == ((VolumeFlag.UNREADABLE_FILES,) if is_flagged else ())


def test_a_file_that_can_be_read_only_once_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    blob, skipped = Fetched("004", bytes(500)), list[Skipped]()
    contents = iter([blob.content])

    def read(_: Fetched, offset: int, count: int) -> bytes:
        for content in contents:
            return content
        raise DamagedError("it cannot be fetched")

    monkeypatch.setattr(Fetched, "read", read)
    assert read_instance(blob, Limits(), skipped) is None
    assert [one.is_trouble for one in skipped] == [True]


def disc_of(folder: Path) -> Path:
    """Write a scan with an index of it, whose records stand in another order than its slices."""
    made, series = FileDataset("", {}, file_meta=FileMetaDataset(), preamble=bytes(128)), Dataset()
    made.file_meta.MediaStorageSOPClassUID = UID(DICOMDIR_CLASS)
    made.file_meta.MediaStorageSOPInstanceUID, made.file_meta.TransferSyntaxUID = (
        UID("1.2"),
        ExplicitVRLittleEndian,
    )
    made.FileSetID, made.DirectoryRecordSequence = "DISC", [series]
    series.DirectoryRecordType, series.SeriesInstanceUID, series.OffsetOfTheNextDirectoryRecord = (
        "SERIES",
        SERIES,
        0,
    )
    for path in write_series(folder, 6).iterdir():
        image = Dataset()
        image.DirectoryRecordType, image.ReferencedSOPInstanceUIDInFile = "IMAGE", dcmread(path).SOPInstanceUID
        made.DirectoryRecordSequence.append(image)
    for one in made.DirectoryRecordSequence:
        one.OffsetOfTheNextDirectoryRecord = one.OffsetOfReferencedLowerLevelDirectoryEntity = 0
    made.save_as(folder / "DICOMDIR")
    made = dcmread(folder / "DICOMDIR")  # which says where in it the records are
    series, *images = made.DirectoryRecordSequence
    series.OffsetOfReferencedLowerLevelDirectoryEntity = images[-1].seq_item_tell
    for one, before in pairwise(reversed(images)):
        one.OffsetOfTheNextDirectoryRecord = before.seq_item_tell
    made.save_as(folder / "DICOMDIR")
    return folder


@pytest.mark.parametrize("packed", [False, True], ids=["folder", "zip"])
def test_a_slice_that_a_disc_s_index_lists_and_that_is_not_there_is_flagged(tmp_path: Path, packed: bool) -> None:
    """At the end of a series nothing else tells that some are missing."""
    disc = disc_of(tmp_path / "disc")

    def flags() -> tuple[VolumeFlag, ...]:
        return read_ct(shutil.make_archive(str(disc), "zip", disc) if packed else disc).flags

    assert flags() == ()
    (disc / "005").unlink()
    assert flags() == (VolumeFlag.MISSING_SLICE,)
    (disc / "DICOMDIR").write_bytes((disc / "DICOMDIR").read_bytes()[:-200])
    assert flags() == (VolumeFlag.UNREADABLE_FILES,)


def test_an_index_whose_records_go_in_a_circle_ends(tmp_path: Path) -> None:
    path = disc_of(tmp_path) / "DICOMDIR"
    made = dcmread(path)
    images = made.DirectoryRecordSequence[1:]
    images[0].OffsetOfTheNextDirectoryRecord = images[-1].seq_item_tell
    made.save_as(path)
    assert read_ct(path).flags == ()


def test_an_index_beside_a_series_is_no_reason_to_doubt_it(tmp_path: Path) -> None:
    write_series(tmp_path)
    (tmp_path / "INDEX").write_bytes(DICOMDIR.read_bytes())
    assert read_ct(tmp_path).flags == ()


def test_a_slice_cut_off_within_its_pixels_makes_the_series_unusable(tmp_path: Path) -> None:
    write_series(tmp_path)
    content = (tmp_path / "002").read_bytes()
    (tmp_path / "002").write_bytes(content[:-10])
    with pytest.raises(
        InputError, match=r"1 of 4 files \(\S+002\): it declares 160 bytes of pixels but holds 150; copy it again"
    ):
        read_ct(tmp_path)
    (tmp_path / "003").write_bytes((tmp_path / "003").read_bytes()[:-10])
    with pytest.raises(InputError, match=r"2 of 4 files \(the first is \S+002\): it declares"):
        read_ct(tmp_path)


def test_a_copy_cut_short_is_passed_over_beside_the_whole_one(tmp_path: Path) -> None:
    """It is the beginning of that, byte for byte; of anything else nobody knows which of the two is right."""
    write_series(tmp_path)
    whole = (tmp_path / "002").read_bytes()
    expected = read_ct(tmp_path)
    (tmp_path / "copy").write_bytes(whole[:-10])
    (one,) = find_series(tmp_path).series
    assert re.search(r"1 of 5 files \(\S+copy\): the beginning of another, .* delete it", one.notes[-1])
    read = read_ct(tmp_path)
    assert read.voxel_sha256 == expected.voxel_sha256
    assert read.flags == (VolumeFlag.UNREADABLE_FILES,)
    (tmp_path / "unread.dcm").write_bytes(b"")
    assert read_ct(tmp_path).flags == (VolumeFlag.UNREADABLE_FILES,)


@pytest.mark.parametrize(
    "written", [lambda whole: whole[:-11] + b"\xff", lambda whole: whole[: whole.index(b"\x28\0\x10\0")]]
)
def test_what_may_be_another_slice_is_no_copy_cut_short(tmp_path: Path, written: Callable[[bytes], bytes]) -> None:
    """Bytes that differ, and a header that ends before the pixels: some programs give all slices one UID."""
    write_series(tmp_path)
    (tmp_path / "copy").write_bytes(written((tmp_path / "002").read_bytes()))
    with pytest.raises(InputError, match=r"1 of 5 files \(\S+copy\): it "):
        read_ct(tmp_path)


def test_a_copy_cut_short_does_not_choose_between_two_whole_ones(tmp_path: Path) -> None:
    write_series(tmp_path)
    other = dataset(2, stored=pattern(7))
    save(other, tmp_path / "other")
    (tmp_path / "copy").write_bytes((tmp_path / "other").read_bytes()[:-10])
    with pytest.raises(InputError, match="different images lie at the same place"):
        read_ct(tmp_path)


def test_a_deflated_slice_cut_short_is_refused(tmp_path: Path) -> None:
    write_series(
        tmp_path, change=lambda made, k: setattr(made.file_meta, "TransferSyntaxUID", "1.2.840.10008.1.2.1.99")
    )
    content = (tmp_path / "002").read_bytes()
    (tmp_path / "002").write_bytes(content[:-40])
    with pytest.raises(InputError, match="002 ends within its pixels"):
        read_ct(tmp_path)


def test_the_order_of_series_does_not_depend_on_the_file_system(tmp_path: Path) -> None:
    for name in "cab":

        def named(made: Dataset, k: int, name: str = name) -> None:
            made.SeriesInstanceUID = f"1.{ord(name)}"

        write_series(tmp_path / name, 2, named)
    assert [one.key for one in find_series(tmp_path).series] == ["1.97", "1.98", "1.99"]


def test_a_summary_tells_what_a_user_chooses_by(tmp_path: Path) -> None:
    heights = [0, 2, 4, 5]
    write_series(tmp_path, change=lambda made, k: setattr(made, "ImagePositionPatient", [0, 0, heights[k]]))
    (one,), skipped = summarize(tmp_path)
    assert (one.series, one.modality, one.description, one.kernel) == (SERIES, "CT", "Head 2 mm", "H30")
    assert (one.images, one.matrix, one.pixel_mm, one.spacing_mm) == (4, (8, 10), (0.5, 0.75), (1, 2))
    assert one.tilt_deg == 0
    assert one.is_usable
    assert one.notes == ("the slices are not evenly spaced", "the slices overlap")
    assert skipped == ()


def test_texts_of_other_alphabets_are_read_and_hostile_ones_escaped(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        made.SpecificCharacterSet = "ISO_IR 192"
        made.SeriesDescription = "Schädel \u202egnp\x1b[2J"

    (one,) = find_series(write_series(tmp_path, change=change)).series
    assert one.first.description == "Schädel \\u202egnp\\x1b[2J"


def test_multi_byte_character_sets_are_read(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        made.SpecificCharacterSet = ["", "ISO 2022 IR 87"]
        made.SeriesDescription = "頭部"

    (one,) = find_series(write_series(tmp_path, change=change)).series
    assert one.first.description == "頭部"


def test_files_that_were_each_given_a_series_are_told_as_such_and_what_to_do(tmp_path: Path) -> None:
    """Five of hundreds of UIDs, each of one slice, told neither the cause nor the remedy."""

    def own_series(made: Dataset, k: int) -> None:
        made.SeriesInstanceUID = generate_uid()

    folder = write_series(tmp_path / "ct", 8, own_series)
    with pytest.raises(
        InputError,
        match=r"but 8 images that are each a series of its own, .* another SeriesInstanceUID; export or anonymize",
    ):
        find_series(folder).choose()
