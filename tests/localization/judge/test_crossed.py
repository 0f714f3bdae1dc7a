"""Screws of tilted posts, which cross a ball's slices on one side of its center and make it fainter there."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import cylinder
from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.judge.crossed import untold_mm2, without_the_screw
from ronnaplan.localization.judge.evidence import Evidence
from ronnaplan.localization.judge.held import what_touches
from ronnaplan.localization.judge.noise import noise_level
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, offsets_mm, scan, small_stack

CENTER_MM, DIAMETER_MM = np.array([0.2, -0.3, 3.1]), 8.0

FAINTER = 0.12
"""So much of its contrast a ball loses to a screw's streak; one of steel took 15 to 22 % of glass."""


def on_a_screw(
    tilt_deg: float,
    *,
    streak: bool = True,
    spacing_mm: float = 0.6,
    diameter_mm: float = DIAMETER_MM,
    material: str = "acrylic",
) -> CTVolume:
    """A ball on a post that rises by ``tilt_deg`` from the slices, whose screw makes a streak where it crosses them."""
    tilt = math.radians(tilt_deg)
    down = np.array([-math.cos(tilt), 0.0, -math.sin(tilt)])
    start_mm = 3.5 if material == "acrylic" else 4.3  # of another material they must not overlap
    post = Part(cylinder(tuple(CENTER_MM + start_mm * down), tuple(down), 18.0, 3.0), "acrylic")
    screw = Part(cylinder(tuple(CENTER_MM + 8.5 * down), tuple(down), 12.0, 2.0), "titanium")
    place = (float(CENTER_MM[0]), float(CENTER_MM[1]), float(CENTER_MM[2]))
    stack = small_stack(spacing_mm=spacing_mm, thickness_mm=spacing_mm)
    seen = scan(Scene((post, screw)) + balls([place], diameter_mm, material), stack)
    if not streak:
        return seen
    x, y, z = offsets_mm(seen, CENTER_MM)
    crossed = (z < 8.5 * down[2] + 1.0) & (x * x + y * y + z * z < 36.0)
    darker = seen.voxels_hu - crossed * FAINTER * (seen.voxels_hu + 1000.0)
    return replace(seen, voxels_hu=np.round(darker).astype(np.int16))


def coronal(axial: CTVolume) -> CTVolume:
    """The same voxels in coronal pictures, from back to front."""
    grid = axial.grid
    rows = np.arange(axial.voxels_hu.shape[1])[::-1, np.newaxis]
    turned = SliceGrid(
        grid.origins_mm[0] + rows * grid.row_step_mm,
        grid.typical_gap_mm * grid.normal,
        grid.column_step_mm,
        grid.row_spacing_mm,
    )
    voxels = np.ascontiguousarray(axial.voxels_hu[:, ::-1].swapaxes(0, 1), dtype=np.int16)
    return replace(axial, voxels_hu=voxels, grid=turned)


def fit_of(volume: CTVolume, diameter_mm: float = DIAMETER_MM) -> BallFit:
    return fit_place(Scan(volume), CENTER_MM + 0.1, diameter_mm)


def untold_of(volume: CTVolume, fit: BallFit) -> FloatArray:
    return untold_mm2(volume, fit, what_touches(volume, fit))


def stated_mm2(volume: CTVolume, fit: BallFit) -> FloatArray:
    return Evidence(fit, DIAMETER_MM, 0.6, 0.6, noise_level(fit), 0.0, volume).covariance_mm2


def test_the_slices_that_a_screw_crosses_do_not_pull_a_ball() -> None:
    volume = on_a_screw(18.0)
    fit = fit_of(volume)
    error_mm = fit.center_mm - CENTER_MM
    assert abs(error_mm[2]) < 0.006  # 0.021 with them
    assert error_mm @ np.linalg.solve(stated_mm2(volume, fit), error_mm) < 7.8


def test_in_coronal_pictures_they_are_the_slices_that_were_measured() -> None:
    fit = fit_of(coronal(on_a_screw(18.0)))
    assert fit.by_part_mm2 is not None
    assert abs(fit.center_mm[2] - CENTER_MM[2]) < 0.010  # 0.042 with them


def test_a_single_slice_that_is_clear_does_not_tell_a_center() -> None:
    assert fit_of(on_a_screw(25.0, streak=False, spacing_mm=3.0)).by_part_mm2 is None  # 17 um off by it


@pytest.mark.parametrize(("spacing_mm", "pulled_mm"), [(1.5, 0.02), (2.0, 0.06)])
def test_a_pull_that_too_few_clear_slices_would_tell_is_stated(spacing_mm: float, pulled_mm: float) -> None:
    """The thicker the slices, the farther the same streak pulls: a constant that holds in thin ones leaves 19."""
    volume = on_a_screw(12.0, spacing_mm=spacing_mm)
    fit = fit_of(volume)
    error_mm = fit.center_mm - CENTER_MM
    assert fit.by_part_mm2 is None
    assert error_mm[2] > pulled_mm
    assert error_mm @ np.linalg.solve(stated_mm2(volume, fit), error_mm) < 7.8  # 10.3 and more where it is not


def test_a_pull_is_stated_where_no_slice_is_clear_either() -> None:
    """Half a slice beside the metal on both sides leaves nothing of a small ball; the lower half is crossed alone."""
    volume = on_a_screw(6.0, streak=False, spacing_mm=2.5, diameter_mm=5.0)
    stated = untold_of(volume, fit_of(volume, 5.0))
    assert math.sqrt(stated[2, 2]) > 0.008  # 0 where it is told by how much is clear


def test_a_pull_is_stated_of_ceramic_that_the_scale_clips() -> None:
    whole = on_a_screw(18.0, material="ceramic")
    volume = replace(whole, voxels_hu=np.minimum(whole.voxels_hu, np.int16(2600)))
    fit = fit_of(volume)
    error_mm = fit.center_mm - CENTER_MM
    assert not fit.is_shaded
    assert error_mm[2] > 0.03
    assert error_mm @ np.linalg.solve(stated_mm2(volume, fit), error_mm) < 7.8  # beyond where it is not


def test_thick_slices_make_no_screw_along_them_one_sided() -> None:
    """Nearly all is crossed, and how much of either end is left says hardly more than where the slices lie."""
    volume = on_a_screw(0.0, streak=False, spacing_mm=2.0)
    assert math.sqrt(untold_of(volume, fit_of(volume))[2, 2]) < 0.004  # 0.013


@pytest.mark.parametrize("tilt_deg", [0.0, 60.0], ids=["along the slices", "steep"])
def test_a_screw_that_crosses_both_halves_or_none_moves_nothing(tilt_deg: float) -> None:
    volume = on_a_screw(tilt_deg, streak=False)
    fit = fit_of(volume)
    assert fit.by_part_mm2 is None
    assert without_the_screw(volume, fit) is fit
    assert np.abs(untold_of(volume, fit)).max() < 1e-6


def test_where_no_pull_shows_the_center_stays() -> None:
    fit = fit_of(on_a_screw(18.0, streak=False))
    assert fit.by_part_mm2 is not None
    assert np.abs(fit.center_mm - CENTER_MM).max() < 0.006


def test_slices_that_put_a_ball_farther_from_its_screw_are_not_believed() -> None:
    """A screw pulls away only: half a ball whose profile is not as fitted errs towards its pole by itself."""
    seen = on_a_screw(18.0, streak=False)
    tails = np.exp(-np.abs(np.arange(-4, 5)))
    blurred = np.apply_along_axis(
        lambda column: np.convolve(column, tails / tails.sum(), "same"), 0, seen.voxels_hu
    )
    fit = fit_of(replace(seen, voxels_hu=np.round(blurred).astype(np.int16, order="C")))
    assert fit.by_part_mm2 is not None
    assert abs(fit.center_mm[2] - CENTER_MM[2]) < 0.0025  # 0.0045 where they are
