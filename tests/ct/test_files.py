import gc
import io
import os
import sys
import weakref
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.ct import Limits, VolumeFlag, find_series, read_ct
from ronnaplan.ct.archives import ZipMember, zip_members
from ronnaplan.ct.files import DamagedError
from ronnaplan.ct.folders import blobs_below
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.ct.reader import read_found
from ronnaplan.errors import InputError
from ronnaplan.portable import is_administrator
from tests.ct.makers import dataset, enhanced, pattern, save, write_series

EXPECTED = np.stack([pattern(k) for k in range(4)]) - 1024


def zipped(folder: Path, target: Path) -> Path:
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            archive.write(path, f"study/{path.relative_to(folder)}")
    return target


def test_a_zip_of_a_study_is_read_without_unpacking_it_to_a_folder(tmp_path: Path) -> None:
    archive = zipped(write_series(tmp_path / "study"), tmp_path / "study.zip")
    before = sorted(tmp_path.rglob("*"))
    assert np.array_equal(read_ct(archive).voxels_hu, EXPECTED)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_large_multi_frame_file_in_a_zip_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ronnaplan.ct.archives._UNPACKED_IN_MEMORY_BYTES", 100)
    (tmp_path / "study").mkdir()
    save(enhanced(4), tmp_path / "study" / "multi")
    assert np.array_equal(read_ct(zipped(tmp_path / "study", tmp_path / "a.zip")).voxels_hu, EXPECTED)


def test_a_zip_that_unpacks_to_more_than_the_limit_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for k in range(4):
            archive.writestr(str(k), bytes(1 << 20))
    with pytest.raises(InputError, match="unpacks to 4194304 bytes, more than the limit"):
        find_series(tmp_path / "bomb.zip", Limits(archive_bytes=3 << 20))
    with pytest.raises(InputError, match="declares 4 members; at most 3 are read: unpack it"):
        find_series(tmp_path / "bomb.zip", Limits(files=3))
    found = find_series(tmp_path / "bomb.zip", Limits(file_bytes=1 << 19))
    assert "above the limit" in found.skipped[0].reason


@pytest.mark.parametrize(
    ("kept", "limits"), [(None, Limits(files=1)), (None, Limits(archive_bytes=9)), (60, DEFAULT_LIMITS)]
)
def test_a_refused_zip_is_closed_while_its_error_is_still_looked_at(
    tmp_path: Path, kept: int | None, limits: Limits
) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("a", bytes(5))
        archive.writestr("b", bytes(5))
    (tmp_path / "a.zip").write_bytes((tmp_path / "a.zip").read_bytes()[:kept])
    raw = io.FileIO(tmp_path / "a.zip")
    with pytest.raises(InputError) as refused:
        next(zip_members(tmp_path / "a.zip", limits, [], raw=raw))
    assert raw.closed
    assert refused.tb is not None


def test_a_zip_with_a_longer_directory_than_it_declares_is_refused_before_it_is_read(tmp_path: Path) -> None:
    """`zipfile` makes an object of each entry in the directory, however few the archive declares."""
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for k in range(20_000):
            archive.writestr(f"{k:0200d}", b"")
    content = bytearray((tmp_path / "a.zip").read_bytes())
    end = content.rfind(b"PK\5\6")
    content[end + 8 : end + 12] = b"\1\0\1\0"
    (tmp_path / "a.zip").write_bytes(content)
    with pytest.raises(InputError, match="its directory is longer than 4194304 bytes"):
        find_series(tmp_path / "a.zip", Limits(header_bytes=1 << 20))
    with pytest.raises(InputError, match="declares 20000 members; at most 10000"):
        find_series(tmp_path / "a.zip", Limits(files=10_000))


def test_a_zip_that_lies_about_sizes_or_is_damaged_is_refused(tmp_path: Path) -> None:
    content = zipped(write_series(tmp_path / "study"), tmp_path / "a.zip").read_bytes()
    (tmp_path / "a.zip").write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="damaged zip archive"):
        read_ct(tmp_path / "a.zip")
    broken = bytearray(content)
    for at in range(100, len(content) // 2, 7):
        broken[at] ^= 0xFF
    (tmp_path / "b.zip").write_bytes(broken)
    with pytest.raises(InputError):
        read_ct(tmp_path / "b.zip")


def test_a_zip_with_a_damaged_member_is_closed_with_its_last_member(tmp_path: Path) -> None:
    content = bytearray(zipped(write_series(tmp_path / "study"), tmp_path / "whole.zip").read_bytes())
    content[content.index(b"PK\x03\x04")] ^= 0xFF
    (tmp_path / "a.zip").write_bytes(content)
    (first, *others) = zip_members(tmp_path / "a.zip", DEFAULT_LIMITS, [])
    assert isinstance(first, ZipMember)
    archive = weakref.ref(first.archive)
    gc.collect()
    gc.disable()  # what is in a circle is closed when that is found, with a warning
    try:
        with suppress(DamagedError):
            first.read(0, 4)
            pytest.fail("it was read")
        del first, others
        assert archive() is None
    finally:
        gc.enable()


def test_what_contradicts_the_sum_of_its_archive_is_not_taken_for_pixels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From Python 3.12 on, `zipfile` no longer checks the sum of a member, stored as it is, that was sought in."""
    seek = zipfile.ZipExtFile.seek

    def as_newer_python(stream: zipfile.ZipExtFile, offset: int, whence: int = 0) -> int:
        vars(stream)["_expected_crc"] = None
        return seek(stream, offset, whence)

    monkeypatch.setattr(zipfile.ZipExtFile, "seek", as_newer_python)
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("slice", bytes(1000))
    content = bytearray((tmp_path / "a.zip").read_bytes())
    content[600] ^= 1
    (tmp_path / "a.zip").write_bytes(content)
    (member,) = zip_members(tmp_path / "a.zip", DEFAULT_LIMITS, [])
    with pytest.raises(DamagedError, match="CRC"):
        member.read(500, 500)


@pytest.mark.parametrize(("name", "is_flagged"), [("ct/rest.zip", True), ("viewer/help.zip", False)])
def test_a_zip_among_slices_in_a_zip_may_hold_others_of_them(tmp_path: Path, name: str, is_flagged: bool) -> None:
    folder = write_series(tmp_path / "ct")
    with zipfile.ZipFile(tmp_path / "outer.zip", "w") as outer:
        for path in folder.iterdir():
            outer.write(path, f"ct/{path.name}")
        outer.writestr(name, b"PK\x03\x04")
    assert read_ct(tmp_path / "outer.zip").flags == ((VolumeFlag.UNREADABLE_FILES,) if is_flagged else ())


def test_an_encrypted_member_is_named(tmp_path: Path) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("secret", b"x" * 10)
    content = bytearray(stream.getvalue())
    content[content.find(b"PK\1\2") + 8] |= 1
    (tmp_path / "a.zip").write_bytes(content)
    assert find_series(tmp_path / "a.zip").skipped[0].reason == "it is encrypted"


def test_a_member_packed_by_a_method_that_is_not_read_is_told(tmp_path: Path) -> None:
    """Windows packs folders of more than 2 GB by Deflate64."""
    content = zipped(write_series(tmp_path / "study"), tmp_path / "a.zip").read_bytes()
    deflate, deflate64 = b"\x14\0\0\0\x08\0", b"\x14\0\0\0\x09\0"
    assert content.count(deflate) == 2 * 4
    (tmp_path / "a.zip").write_bytes(content.replace(deflate, deflate64))
    with pytest.raises(InputError, match="packed by method 9, which is not read; unpack the archive first"):
        read_ct(tmp_path / "a.zip")


def test_links_in_circles_end_and_linked_files_count_once(tmp_path: Path) -> None:
    write_series(tmp_path / "a")
    (tmp_path / "a" / "loop").symlink_to(tmp_path)
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "a" / "again").symlink_to(tmp_path / "a" / "000")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    volume = read_ct(tmp_path)
    assert np.array_equal(volume.voxels_hu, EXPECTED)
    assert volume.flags == (VolumeFlag.UNREADABLE_FILES,)


@pytest.mark.skipif(sys.platform == "win32" or is_administrator(), reason="root, and Windows, may read everything")
def test_a_file_without_permission_is_named_and_flagged(tmp_path: Path) -> None:
    write_series(tmp_path)
    (tmp_path / "003").chmod(0)
    found = find_series(tmp_path)
    assert "Permission denied" in found.skipped[0].reason
    assert VolumeFlag.UNREADABLE_FILES in read_ct(tmp_path).flags


def test_a_file_that_cannot_be_opened_is_named_and_flagged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_series(tmp_path)
    opened = os.open

    def refusing(path: str, *rest: int) -> int:
        if str(path).endswith("003"):
            raise PermissionError(13, "Permission denied")
        return opened(path, *rest)

    monkeypatch.setattr(os, "open", refusing)
    found = find_series(tmp_path)
    assert (
        found.skipped[0].reason
        == "it cannot be opened (Permission denied); see whether it is there and may be read"
    )
    assert read_ct(tmp_path).flags == (VolumeFlag.UNREADABLE_FILES,)


def test_more_files_than_the_limit_are_refused_before_any_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_series(tmp_path)
    monkeypatch.setattr(os, "pread", lambda *_: pytest.fail("a file was read"))
    with pytest.raises(InputError, match="holds more than 3 files; name a narrower folder"):
        find_series(tmp_path, Limits(files=3))


def test_folders_nested_beyond_the_limit_are_left_out_and_named(tmp_path: Path) -> None:
    write_series(tmp_path / "a" / "b" / "c")
    found = find_series(tmp_path, Limits(folder_depth=2))
    assert found.series == ()
    assert found.skipped[0].reason == "the folders nest too deeply; name this one by itself"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
def test_pipes_and_devices_are_never_opened(tmp_path: Path) -> None:
    write_series(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    assert read_ct(tmp_path).voxels_hu.shape[0] == 4
    with pytest.raises(InputError, match="neither a file nor a folder; give the path"):
        read_ct(tmp_path / "pipe")


def test_a_path_that_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match=r"cannot be opened .*; check the path"):
        read_ct("a\0b")


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")
@pytest.mark.parametrize("longer", [False, True])
def test_a_slice_that_is_replaced_between_its_header_and_its_pixels_is_refused(
    tmp_path: Path, longer: bool
) -> None:
    folder = write_series(tmp_path)
    for path in folder.iterdir():
        os.utime(path, ns=(10**18, 10**18))
    found = find_series(folder)
    made = dataset(1)
    made.PixelData = pattern(7).tobytes()
    made.SeriesDescription += ".." * longer
    save(made, folder / "001")
    if longer:
        os.utime(folder / "001", ns=(10**18, 10**18))
    with pytest.raises(
        InputError, match="001 cannot be read: it was changed since it was listed; read it again when"
    ):
        read_found(found)
    read_ct(folder)


def test_each_file_is_met_once_by_whatever_names_and_only_those_of_several_are_remembered(tmp_path: Path) -> None:
    inside, outside = tmp_path / "scans", tmp_path / "elsewhere"
    (inside / "a").mkdir(parents=True)
    outside.mkdir()
    for name in (inside / "a" / "1", inside / "2", outside / "3", outside / "4", inside / "5"):
        name.write_text(name.name)
    (inside / "hard").hardlink_to(inside / "2")
    (inside / "to a file").symlink_to(inside / "a" / "1")
    (inside / "to a folder").symlink_to(inside / "a")
    (inside / "a" / "loop").symlink_to(inside)
    (inside / "out").symlink_to(outside)
    (inside / "a" / "out, too").symlink_to(outside)
    (inside / "a" / "out to a file").symlink_to(outside / "4")
    met = [Path(one.name) for one in blobs_below(inside, DEFAULT_LIMITS, [])]
    assert sorted(one.read_text() for one in met) == ["1", "2", "3", "4", "5"]
