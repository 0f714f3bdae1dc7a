"""Grey values, as mobile C-arms and exported pictures hold them, are brought to HU; what may be HU is left as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.localization import localize
from ronnaplan.localization.scanner.hounsfield import in_hounsfield
from ronnaplan.localization.size import sizes_seen
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack

CENTERS_MM = [(-15.2, -14.1, 8.3), (14.7, -12.6, -6.2), (1.3, 15.4, 2.1)]


@pytest.fixture(scope="module")
def shown() -> CTVolume:
    return scan(balls(CENTERS_MM), small_stack(), noise_hu=20.0)


def grey(volume: CTVolume, factor: float, offset: float, top: float) -> CTVolume:
    """Return the scan with air at ``offset``, as whole numbers up to ``top``."""
    values = np.clip((volume.voxels_hu + 1000.0) * factor + offset, min(offset, 0.0), top).round()
    return replace(volume, voxels_hu=values.astype(np.float32))


@few_and_others(("factor", "offset", "top"), [(0.1, 0.0, 255.0)], [(0.25, 40.0, 1000.0), (10.0, 0.0, 65535.0)])
def test_balls_are_found_in_grey_values(shown: CTVolume, factor: float, offset: float, top: float) -> None:
    found = localize(grey(shown, factor, offset, top), diameter_mm=11.5)
    assert VolumeFlag.SCALED in found.volume_flags
    assert len(found) == len(CENTERS_MM)
    for center_mm in CENTERS_MM:
        assert np.linalg.norm(found.centers - center_mm, axis=1).min() < 0.02
    assert all(one.contrast_hu == pytest.approx(1120.0, rel=0.15) for one in found)


def test_their_size_is_told_too(shown: CTVolume) -> None:
    (size,) = sizes_seen(grey(shown, 0.1, 0.0, 255.0))
    assert size.count == len(CENTERS_MM)
    assert size.diameter_mm == pytest.approx(11.5, abs=0.05)


@pytest.mark.parametrize("offset", [0, 1024, -500])
def test_values_that_are_off_by_an_offset_are_left(shown: CTVolume, offset: int) -> None:
    volume = replace(shown, voxels_hu=shown.voxels_hu + np.int16(offset))
    assert in_hounsfield(volume) is volume


def test_padding_is_scaled_with_the_scan(shown: CTVolume) -> None:
    volume = grey(shown, 0.1, 0.0, 255.0)
    volume.voxels_hu[:, :4] = -100.0
    seen = in_hounsfield(replace(volume, padding_hu=-100.0))
    assert seen.padding_hu == seen.voxels_hu[0, 0, 0] < -1800.0


def test_a_crop_of_brain_fat_and_bone_is_left(shown: CTVolume) -> None:
    """It shows no air, but metal or bone beside what lies near together."""
    generator = np.random.default_rng(1)
    kinds = generator.choice([-100.0, 40.0, 1200.0], p=[0.3, 0.65, 0.05], size=shown.voxels_hu.shape)
    values = (kinds + generator.normal(0.0, 10.0, kinds.shape)).astype(np.int16)
    for crop in (values, np.where(values < 0, 40, values)):
        volume = replace(shown, voxels_hu=crop.astype(np.int16))
        assert in_hounsfield(volume) is volume


def test_metal_in_tissue_without_air_is_left(shown: CTVolume) -> None:
    values = np.full(shown.voxels_hu.shape, 40, np.int16)
    values[0, :, :50] = 3071  # below a hundredth of all
    volume = replace(shown, voxels_hu=values)
    assert in_hounsfield(volume) is volume


@pytest.mark.parametrize("padding", [0.0, 7.0])
def test_a_scan_of_padding_or_of_one_value_alone_is_left(shown: CTVolume, padding: float) -> None:
    volume = replace(shown, voxels_hu=np.zeros_like(shown.voxels_hu), padding_hu=padding)
    assert in_hounsfield(volume) is volume
