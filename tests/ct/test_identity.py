"""Two things are of one examination by their frames; voxels tell where frames do not, or a series was replaced."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ronnaplan.ct.identity import ScanIdentity
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame

SCAN = ScanIdentity("the scan", Frame("CT", "1.2"), "1.2.3", "a" * 64)
OTHER_VOXELS = replace(SCAN, name="the plan", voxel_sha256="b" * 64)


def test_one_series_has_one_set_of_voxels() -> None:
    with pytest.raises(
        InputError, match=r"^the plan is of other voxels than the scan though both name series 1\.2\.3"
    ):
        SCAN.require(OTHER_VOXELS)
    SCAN.require(replace(SCAN, name="the plan"))


@pytest.mark.parametrize(("series_uid", "voxels"), [("1.2.4", "b" * 64), (None, "b" * 64), ("1.2.3", None)])
def test_another_series_of_the_frame_is_the_same_head(series_uid: str | None, voxels: str | None) -> None:
    SCAN.require(ScanIdentity("the plan", SCAN.frame, series_uid, voxels))


def test_another_frame_is_another_examination_whatever_the_voxels() -> None:
    with pytest.raises(FrameMismatchError, match=r"the plan is in frame CT \[9\] but the scan in CT \[1\.2\]"):
        SCAN.require(replace(SCAN, name="the plan", frame=Frame("CT", "9")))


def test_without_a_frame_only_stated_voxels_tell() -> None:
    nameless = replace(SCAN, frame=Frame("CT"))
    nameless.require(replace(nameless, series_uid="1.2.4"))
    for voxels in (None, "b" * 64):
        with pytest.raises(FrameMismatchError, match="voxels differ or are not stated"):
            nameless.require(replace(nameless, voxel_sha256=voxels))
    with pytest.raises(FrameMismatchError, match="not stated"):
        replace(nameless, voxel_sha256=None).require(replace(nameless, voxel_sha256=None))
