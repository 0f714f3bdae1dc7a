"""Every series below the roots is found, once; only headers of new and changed files are read."""

from __future__ import annotations

import os
import shutil
import sys
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import fsspec
import numpy as np
import pydicom.data
import pytest

from ronnaplan.cohort import listing
from ronnaplan.cohort.index import Index
from ronnaplan.cohort.listing import bring_up_to_date
from ronnaplan.cohort.places import LIMITS, Place, kept_name
from ronnaplan.cohort.planning import _troubled
from ronnaplan.ct import read_ct
from ronnaplan.ct.catalogue import catalogue_of, read_instance
from ronnaplan.ct.files import Skipped
from ronnaplan.ct.reader import read_series
from ronnaplan.errors import InputError
from tests.cohort.scans import SLICES, tiny
from tests.faults import shut

DICOMDIR = Path(pydicom.data.__file__).parent / "test_files" / "dicomdirtests" / "DICOMDIR"


@pytest.fixture
def index(tmp_path: Path) -> Iterator[Index]:
    (tmp_path / "out").mkdir()
    with Index(tmp_path / "out") as found:
        yield found


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The files whose headers were read."""
    names: list[str] = []

    def noting(blob, *given):  # type: ignore[no-untyped-def]
        names.append(blob.name)
        return read_instance(blob, *given)

    monkeypatch.setattr(listing, "read_instance", noting)
    return names


def found(index: Index) -> dict[str, tuple[str, int, int]]:
    """Series -> folder, files, revision."""
    return {
        uid.rpartition(".")[2]: (folder, files, revision)
        for uid, folder, files, revision in index.rows(
            "SELECT series_uid, folder, (SELECT COUNT(*) FROM files WHERE series = series.id), revision FROM series"
        )
    }


def zipped(folder: Path, archive: Path) -> Path:
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as made:
        for path in sorted(folder.iterdir()):
            made.write(path, f"study/{path.name}")
    return archive


def test_folders_and_archives_are_listed_and_read_again_only_where_they_changed(
    index: Index, tmp_path: Path, read: list[str]
) -> None:
    root = tmp_path / "in"
    tiny(root / "a", "1", StationName="CT-1", ManufacturerModelName="Model", DeviceSerialNumber="7")
    tiny(root / "a", "2")
    zipped(tiny(tmp_path / "elsewhere", "3"), root / "b.zip")
    (root / "notes.txt").write_text("no scan")
    listed = bring_up_to_date(index, [str(root)])
    assert (listed.files, listed.changed) == (2 * SLICES + 2, 2 * SLICES + 2)
    first = found(index)
    assert {name: (folder, files) for name, (folder, files, _) in first.items()} == {
        **{"1": ("a", SLICES), "2": ("a", SLICES)},
        "3": ("study", SLICES),
    }
    assert index.rows("SELECT station, device FROM series WHERE folder = 'a' ORDER BY series_uid")[0] == (
        "CT-1",
        "Model 7",
    )
    read.clear()
    assert bring_up_to_date(index, [str(root)]).changed == 0
    assert read == []
    assert found(index) == first
    os.utime(root / "a" / "1-000", ns=(1, 1))
    zipped(tiny(tmp_path / "elsewhere", "4"), root / "b.zip")
    (root / "a" / "2-001").unlink()
    bring_up_to_date(index, [str(root)])
    assert len(read) == 1 + 1 + 2 * SLICES  # the touched slice, the archive itself, its members
    again = found(index)
    assert again["2"][1] == SLICES - 1
    assert again["4"][1] == SLICES
    assert all(again[name][2] > first[name][2] for name in "123")
    (root / "b.zip").unlink()
    bring_up_to_date(index, [str(root)])
    assert set(found(index)) == {"1", "2"}


def test_a_dicomdir_stands_for_its_folder(index: Index) -> None:
    bring_up_to_date(index, [str(DICOMDIR)])
    by_index = index.rows("SELECT study_uid, series_uid FROM series ORDER BY 1, 2")
    assert {modality for (modality,) in index.rows("SELECT modality FROM series")} >= {"CT", "MR", "CR"}
    index.run("DELETE FROM files")
    bring_up_to_date(index, [str(DICOMDIR.parent)])
    by_folder = index.rows("SELECT study_uid, series_uid FROM series ORDER BY 1, 2")
    assert by_index == by_folder


@pytest.mark.parametrize("protocol", ["", "file://"])
def test_a_folder_that_cannot_be_opened_loses_nothing(
    index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, protocol: str
) -> None:
    tiny(tmp_path / "in" / "a", "1")
    root = f"{protocol}{tmp_path / 'in'}"
    bring_up_to_date(index, [root])
    shut(monkeypatch, "a")
    listed = bring_up_to_date(index, [root])
    assert "cannot be opened" in listed.skipped[0]
    assert found(index)["1"][1] == SLICES
    with pytest.raises(InputError, match="there is no file or folder"):
        bring_up_to_date(index, [str(tmp_path / "nowhere")])
    assert found(index)["1"][1] == SLICES


def test_a_folder_that_cannot_be_opened_is_kept_in_mind_until_it_can(
    index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny(tmp_path / "in" / "a", "1")
    (tmp_path / "in" / "a" / "more").mkdir()
    tiny(tmp_path / "in" / "b", "2")
    kept = "SELECT folder, name, reason FROM files WHERE trouble"
    with monkeypatch.context() as patched:
        shut(patched, "more")
        for _ in range(2):
            assert bring_up_to_date(index, [str(tmp_path / "in")]).files == 2 * SLICES
            assert index.rows(kept) == [
                (
                    "a",
                    "more",
                    "the folder cannot be opened (Permission denied); see whether it is there and may be read",
                )
            ]
        beside = index.rows("SELECT DISTINCT series FROM files WHERE folder = 'a' AND series IS NOT NULL")
        assert _troubled(index) == {number for (number,) in beside}
    bring_up_to_date(index, [str(tmp_path / "in")])
    assert index.rows(kept) == []


@pytest.mark.parametrize("protocol", ["", "file://"])
def test_what_was_deleted_is_no_part_of_a_cohort(index: Index, tmp_path: Path, protocol: str) -> None:
    tiny(tmp_path / "in" / "scans", "1")
    tiny(tmp_path / "in" / "$RECYCLE.BIN" / "S-1-5-21", "2")
    listed = bring_up_to_date(index, [f"{protocol}{tmp_path / 'in'}"])
    assert (listed.files, listed.skipped) == (SLICES, [])
    assert set(found(index)) == {"1"}


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")
def test_a_link_that_leads_nowhere_keeps_no_file_elsewhere(index: Index, tmp_path: Path) -> None:
    root = tiny(tmp_path / "in", "1")
    tiny(root / "a", "2")
    (root / "disk").mkdir()
    tiny(root / "disk" / "b", "3")
    bring_up_to_date(index, [str(root)])
    for name in ("a", "disk"):
        shutil.rmtree(root / name)
    (root / "disk").symlink_to(tmp_path / "not mounted")
    (listed,) = bring_up_to_date(index, [str(root)]).skipped
    assert "disk: it cannot be opened" in listed
    assert set(found(index)) == {"1", "3"}


def test_a_root_whose_files_are_all_gone_is_told_and_loses_nothing(index: Index, tmp_path: Path) -> None:
    root = tiny(tmp_path / "in", "1")
    bring_up_to_date(index, [str(root)])
    root.rename(tmp_path / "unmounted")
    root.mkdir()
    for _ in range(2):
        assert "it is empty, and was not" in bring_up_to_date(index, [str(root)]).skipped[0]
        assert found(index)["1"][1] == SLICES
        assert _troubled(index) == set()  # its results stay as they are


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")
def test_a_root_without_the_link_that_led_nowhere_has_lost_nothing(index: Index, tmp_path: Path) -> None:
    (root := tmp_path / "in").mkdir()
    (root / "disk").symlink_to(tmp_path / "not mounted")
    assert "disk: it cannot be opened" in bring_up_to_date(index, [str(root)]).skipped[0]
    (root / "disk").unlink()
    assert bring_up_to_date(index, [str(root)]).skipped == []
    assert index.value("SELECT COUNT(*) FROM files") == 0


def test_a_damaged_archive_is_told_each_time_and_stops_nothing(index: Index, tmp_path: Path) -> None:
    tiny(tmp_path / "in", "1")
    (tmp_path / "in" / "x.zip").write_bytes(b"PK\x03\x04 and no more")
    for _ in range(2):
        listed = bring_up_to_date(index, [str(tmp_path / "in")])
        assert "damaged zip archive" in listed.skipped[0]
        assert set(found(index)) == {"1"}


@pytest.mark.parametrize("content", [b"", b"x"])
@pytest.mark.parametrize("protocol", ["", "file://"])
def test_what_is_named_like_an_archive_and_is_none_is_told_as_a_damaged_one(
    index: Index, tmp_path: Path, content: bytes, protocol: str
) -> None:
    tiny(tmp_path / "in", "1")
    (tmp_path / "in" / "x.zip").write_bytes(content)
    for root in (tmp_path / "in", tmp_path / "in", tmp_path / "in" / "x.zip"):
        (told,) = bring_up_to_date(index, [f"{protocol}{root}"]).skipped
        assert "x.zip is a damaged zip archive" in told
        assert set(found(index)) == {"1"}


def test_results_below_a_root_are_not_listed(index: Index, tmp_path: Path) -> None:
    tiny(tmp_path / "in", "1")
    (tmp_path / "out" / "series").mkdir()
    (tmp_path / "out" / "series" / "fiducials.json").write_text("{}")
    assert bring_up_to_date(index, [str(tmp_path)]).files == SLICES
    assert {folder for (folder,) in index.rows("SELECT folder FROM files")} == {"in"}


def test_an_archive_within_an_archive_is_told_each_time(index: Index, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    zipped(tiny(tmp_path / "elsewhere", "1"), tmp_path / "in" / "a.zip")
    with zipfile.ZipFile(tmp_path / "in" / "outer.zip", "w") as made:
        made.write(tmp_path / "in" / "a.zip", "study/a.zip")
    for _ in range(2):
        (told,) = bring_up_to_date(index, [str(tmp_path / "in")]).skipped
        assert told.startswith(f"{tmp_path / 'in' / 'outer.zip'}:study/a.zip: an archive within an archive")
    (tmp_path / "in" / "outer.zip").unlink()
    assert not bring_up_to_date(index, [str(tmp_path / "in")]).skipped


def test_members_that_cannot_be_read_are_told_each_time_and_alone_tried_again(
    index: Index, tmp_path: Path, read: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "in").mkdir()
    archive = zipped(tiny(tmp_path / "elsewhere", "1"), tmp_path / "in" / "a.zip")
    opened = zipfile.ZipFile.open

    def failing(self: zipfile.ZipFile, info: zipfile.ZipInfo) -> object:
        if info.filename.endswith("1-002"):
            raise OSError(5, "Input/output error")
        return opened(self, info)

    with monkeypatch.context() as patched:
        patched.setattr(zipfile.ZipFile, "open", failing)
        for _ in range(2):
            (told,) = bring_up_to_date(index, [str(tmp_path / "in")]).skipped
            assert "a.zip:study/1-002: it cannot be unpacked ([Errno 5] Input/output error)" in told
            assert found(index) == {"1": ("study", SLICES - 1, 1)}
    read.clear()
    for _ in range(2):
        assert not bring_up_to_date(index, [str(tmp_path / "in")]).skipped
        assert found(index) == {"1": ("study", SLICES, 2)}
    assert read == [str(archive), f"{archive}:study/1-002"]


def test_an_archive_with_two_members_of_one_name_stops_nothing(index: Index, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    archive = zipped(tiny(tmp_path / "elsewhere", "1"), tmp_path / "in" / "a.zip")
    with zipfile.ZipFile(archive, "a") as made, pytest.warns(UserWarning, match="Duplicate name"):
        made.write(tmp_path / "elsewhere" / "1-002", "study/1-002")
    assert not bring_up_to_date(index, [str(tmp_path / "in")]).skipped
    assert found(index) == {"1": ("study", SLICES, 1)}


def test_files_that_cannot_be_read_are_told_and_tried_again(
    index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tiny(tmp_path / "in", "1").parent
    zipped(tiny(tmp_path / "elsewhere", "2"), root / "in" / "b.zip")
    opened = os.open

    def refusing(path: str, *rest: int) -> int:
        if str(path).endswith(("1-002", "b.zip")):
            raise PermissionError(13, "Permission denied")
        return opened(path, *rest)

    with monkeypatch.context() as patched:
        patched.setattr(os, "open", refusing)
        skipped = bring_up_to_date(index, [str(root / "in")]).skipped
        assert "1-002: it cannot be opened" in skipped[0]
        assert "b.zip: it cannot be opened" in skipped[1]
        assert {name: files for name, (_, files, _) in found(index).items()} == {"1": SLICES - 1}
    assert not bring_up_to_date(index, [str(root / "in")]).skipped
    assert {name: files for name, (_, files, _) in found(index).items()} == {"1": SLICES, "2": SLICES}


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
@pytest.mark.parametrize("protocol", ["", "file://"])
def test_names_that_are_no_utf_8_are_as_good_as_others(index: Index, tmp_path: Path, protocol: str) -> None:
    root = tmp_path / os.fsdecode(b"M\xfcller")
    tiny(root / os.fsdecode(b"\xe4"), "1")
    place = Place(kept_name(f"{protocol}{root}"))
    bring_up_to_date(index, [place.root])
    files = index.rows("SELECT folder, name, size FROM files ORDER BY name")
    assert len(catalogue_of(tmp_path, place.blobs(files, []), LIMITS).series[0].stack.slices) == SLICES  # type: ignore[union-attr]


@pytest.mark.parametrize("protocol", ["file", "memory"])
def test_what_lies_behind_a_url_is_listed_and_read_as_if_it_lay_here(
    index: Index, tmp_path: Path, protocol: str, read: list[str]
) -> None:
    here = tiny(tmp_path / "in" / "a", "1")
    archive = zipped(here, tmp_path / "in" / "b.zip")
    root = f"file://{tmp_path / 'in'}" if protocol == "file" else f"memory:///cohort-{tmp_path.name}"
    if protocol == "memory":
        memory = fsspec.filesystem("memory")
        for path in (*here.iterdir(), archive):
            memory.pipe(f"/cohort-{tmp_path.name}/{path.relative_to(tmp_path / 'in')}", path.read_bytes())
    bring_up_to_date(index, [root])
    assert sorted(index.rows("SELECT archive, folder FROM series JOIN places ON places.id = place")) == [
        ("", "a"),
        ("b.zip", "study"),
    ]
    read.clear()
    bring_up_to_date(index, [root])
    assert read == []
    expected = read_ct(here)
    for place in (Place(root), Place(root, "b.zip")):
        number = index.place(place)
        files = index.rows("SELECT folder, name, size FROM files WHERE place = ? AND series NOT NULL", number)
        blobs = place.blobs(files, [])
        (series,) = catalogue_of(tmp_path, blobs, LIMITS).series
        volume = read_series(series)
        assert np.array_equal(volume.voxels_hu, expected.voxels_hu)
        assert np.array_equal(volume.grid.origins_mm, expected.grid.origins_mm)


def test_what_fsspec_unpacks_is_read_to_its_first_letter(index: Index, tmp_path: Path) -> None:
    """The names of an archive's members begin with no slash."""
    archive = zipped(tiny(tmp_path / "in" / "a", "1"), tmp_path / "b.zip")
    listed = bring_up_to_date(index, [f"zip://::file://{archive}"])
    assert [listed.files, listed.skipped] == [SLICES, []]
    assert index.rows("SELECT folder FROM series") == [("study",)]


def test_a_series_is_described_as_its_files_are_now(index: Index, tmp_path: Path) -> None:
    def described() -> list[tuple[str, str]]:
        bring_up_to_date(index, [str(tmp_path / "in")])
        return index.rows("SELECT folder, description FROM series")

    tiny(tmp_path / "in" / "b", "1", SeriesDescription="as sent")
    assert described() == [("b", "as sent")]
    (tmp_path / "in" / "b").rename(tmp_path / "in" / "phantom")
    assert described() == [("phantom", "as sent")]
    tiny(tmp_path / "in" / "phantom", "1", SeriesDescription="corrected")
    assert described() == [("phantom", "corrected")]
    first = min((tmp_path / "in" / "phantom").iterdir())
    (tmp_path / "in" / "a").mkdir()
    first.rename(tmp_path / "in" / "a" / first.name)
    assert described() == [("a", "corrected")]
    shutil.rmtree(tmp_path / "in" / "a")
    assert described() == [("phantom", "corrected")]
    tiny(tmp_path / "in" / "z", "1", SeriesDescription="a copy")  # as whatever was listed when
    assert described() == [("phantom", "corrected")]


@pytest.mark.skipif(sys.platform == "win32", reason="the system has no such names")
@pytest.mark.parametrize("protocol", ["", "file://", "memory://"])
def test_names_that_look_like_patterns_stand_for_themselves(index: Index, tmp_path: Path, protocol: str) -> None:
    root = tmp_path / "in"
    first, second, *_ = sorted(tiny(root / "head [bone]", "1").iterdir())
    first.rename(first.with_name("[1].dcm"))
    second.rename(second.with_name("?*.dcm"))
    if protocol == "memory://":
        for path in (root / "head [bone]").iterdir():
            fsspec.filesystem("memory").pipe(str(path), path.read_bytes())
    place = Place(f"{protocol}{root}")
    bring_up_to_date(index, [place.root])
    files = index.rows("SELECT folder, name, size FROM files ORDER BY name")
    skipped: list[Skipped] = []
    blobs = place.blobs(files, skipped)
    assert [len(blobs), skipped] == [SLICES, []]
    assert [blob.name.rpartition("/")[2] for blob in blobs] == [name for _, name, _ in files]


def test_a_url_that_nothing_opens_is_told(index: Index, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="cannot be opened"):
        bring_up_to_date(index, ["nonsense://x"])
    with pytest.raises(InputError, match="No such file"):
        bring_up_to_date(index, ["zip://::file:///none.zip"])

    def failing(*_: object, **__: object) -> bool:
        raise RuntimeError("no credentials")  # each store's library has errors of its own

    with monkeypatch.context() as patched:
        patched.setattr(type(fsspec.filesystem("memory")), "ls", failing)
        listed = bring_up_to_date(index, ["memory://"])
    assert listed.skipped == ["memory://: the folder cannot be opened (no credentials); see to its store"]
    monkeypatch.setattr(type(fsspec.filesystem("memory")), "exists", failing)
    with pytest.raises(InputError, match="cannot be listed"):
        bring_up_to_date(index, ["memory://x"])


@pytest.mark.parametrize(
    ("status", "says"), [(0, "cannot be reached"), (503, "cannot be reached"), (404, "no file")]
)
def test_a_web_server_that_does_not_answer_is_told_from_one_that_has_no_such_file(
    index: Index, status: int, says: str
) -> None:
    pytest.importorskip("aiohttp")

    class Answering(BaseHTTPRequestHandler):
        def do_GET(self) -> None:  # the library's name
            self.send_error(status)

        do_HEAD = do_GET  # noqa: N815

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Answering) as server:
        address = f"http://127.0.0.1:{server.server_port}/scans.zip"
        if status:
            Thread(target=server.serve_forever, daemon=True).start()
        else:
            server.server_close()
        try:
            with pytest.raises(InputError, match=f"{says}.*" if status == 404 else f"{address} {says}"):
                bring_up_to_date(index, [address])
        finally:
            if status:
                server.shutdown()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no such files")
def test_a_pipe_behind_a_url_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    assert [one.name for one in Place(f"file://{tmp_path}").files([])] == ["file"]
