"""Whatever voxels a scan holds, and however few, its markers are told or refused; a warning is an error here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.errors import RonnaplanError
from ronnaplan.localization import Build, localize
from ronnaplan.localization.size import sizes_seen
from tests.long import few_and_others

SCANS = 60
TRIED_EACH_TIME = 20
BUILDS = [Build.parse(one) for one in ("solid", "solid", "solid", "shell:1", "wrapped:1.5")]


def any_scan(seed: int) -> CTVolume:
    """Ellipsoids of any level that cut each other, one to forty slices, any scale's ends, gaps, tilt and tag."""
    generator = np.random.default_rng([seed, 6])
    shape = (int(generator.choice([1, 2, 3, 8, 24, 40])), *generator.integers(20, 90, 2).tolist())
    pixel_mm, spacing_mm = generator.uniform(0.25, 1.2), generator.uniform(0.3, 5.0)
    steps_mm = np.array([spacing_mm, pixel_mm, pixel_mm])
    voxels = np.full(shape, float(generator.choice([-1000, -1024, 0, -500])))
    places = np.moveaxis(np.indices(shape), 0, -1)
    for _ in range(generator.integers(0, 20)):
        half = generator.uniform(0.5, 8.0) * generator.uniform(0.7, 1.4, 3) / steps_mm
        inside = np.sum(((places - generator.uniform(0, 1, 3) * shape) / half) ** 2, axis=-1) < 1.0
        voxels[inside] = generator.choice([100, 1500, 3000, 8000, 30000, -2000])
    voxels = gaussian_filter(voxels, generator.uniform(0.0, 1.3, 3))
    voxels += generator.standard_normal(shape) * generator.choice([0, 5, 200])
    voxels = np.clip(voxels, generator.choice([-1024, -32768, 0]), generator.choice([3071, 32767, 300])).round()
    heights_mm = np.cumsum(generator.uniform(0.5, 1.5, shape[0])) * spacing_mm
    tilt = generator.choice([0.0, 0.0, 0.3])
    origins_mm = np.stack([0.0 * heights_mm, tilt * heights_mm, heights_mm], axis=-1)
    tag_mm = generator.choice([0.01, spacing_mm, 30.0])
    steps = np.array([0.0, pixel_mm, 0.0]), np.array([pixel_mm, 0.0, 0.0])
    grid = SliceGrid(origins_mm, *steps, float(tag_mm) if generator.random() < 0.8 else None)
    return CTVolume(voxels.astype(np.int16), grid)


@few_and_others("seed", range(TRIED_EACH_TIME), range(TRIED_EACH_TIME, SCANS))
def test_any_voxels_are_answered_or_refused(seed: int) -> None:
    volume, generator = any_scan(seed), np.random.default_rng([seed, 7])
    diameter_mm = float(generator.uniform(1.5, 14.0))
    try:
        found = localize(volume, diameter_mm=diameter_mm, marker=BUILDS[seed % len(BUILDS)])
    except RonnaplanError:
        return
    for one in found:
        assert np.isfinite(one.center_mm).all()
        assert np.linalg.eigvalsh(one.covariance_mm2).min() > 0.0


@pytest.mark.parametrize("slices", [2, 3])
def test_a_few_slices_hold_no_ball(slices: int) -> None:
    grid = SliceGrid(
        np.array([[0.0, 0.0, 0.5 * k] for k in range(slices)]),
        *(np.array([0.0, 0.5, 0.0]), np.array([0.5, 0.0, 0.0]), 0.5),
    )
    volume = CTVolume(np.full((slices, 96, 96), -1000, dtype=np.int16), grid)
    assert len(localize(volume, diameter_mm=11.5)) == 0
    assert sizes_seen(volume) == ()
