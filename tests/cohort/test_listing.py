"""Every series below the roots is found, once; only headers of new and changed files are read."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator
from pathlib import Path

import fsspec
import numpy as np
import pydicom.data
import pytest

from ronnaplan.cohort import listing
from ronnaplan.cohort.index import Index
from ronnaplan.cohort.listing import bring_up_to_date
from ronnaplan.cohort.places import LIMITS, Place
from ronnaplan.ct import read_ct
from ronnaplan.ct.catalogue import catalogue_of, read_instance
from ronnaplan.ct.reader import read_series
from ronnaplan.errors import InputError
from tests.cohort.scans import SLICES, tiny

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


def test_a_folder_that_cannot_be_opened_loses_nothing(
    index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny(tmp_path / "in" / "a", "1")
    bring_up_to_date(index, [str(tmp_path / "in")])
    scan = os.scandir

    def failing(path: str) -> object:
        if str(path).endswith("a"):
            raise PermissionError(13, "Permission denied")
        return scan(path)

    monkeypatch.setattr(os, "scandir", failing)
    listed = bring_up_to_date(index, [str(tmp_path / "in")])
    assert "cannot be opened" in listed.skipped[0]
    assert found(index)["1"][1] == SLICES
    with pytest.raises(InputError, match="there is no file or folder"):
        bring_up_to_date(index, [str(tmp_path / "nowhere")])
    assert found(index)["1"][1] == SLICES


def test_a_damaged_archive_is_told_and_stops_nothing(index: Index, tmp_path: Path) -> None:
    tiny(tmp_path / "in", "1")
    (tmp_path / "in" / "x.zip").write_bytes(b"PK\x03\x04 and no more")
    listed = bring_up_to_date(index, [str(tmp_path / "in")])
    assert "damaged zip archive" in listed.skipped[0]
    assert set(found(index)) == {"1"}


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


def test_a_url_that_nothing_opens_is_told(index: Index) -> None:
    with pytest.raises(InputError, match="cannot be opened"):
        bring_up_to_date(index, ["nonsense://x"])
