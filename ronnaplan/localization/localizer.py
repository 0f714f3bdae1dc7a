"""From a scan to its markers: detect, fit, accept. This file is the pipeline's own description."""

from __future__ import annotations

import math

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.errors import InputError, RefusedError, UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.accept import MIN_COVERAGE, Evidence, failures, profile_share
from ronnaplan.localization.detect import detect
from ronnaplan.localization.fiducials import Fiducial, FiducialFlag, Fiducials, Rejected
from ronnaplan.localization.neighbourhood import gather
from ronnaplan.localization.refine import BallFit, fit_ball, margin_mm, on_surface
from ronnaplan.localization.uncertainty import center_covariance

MIN_VOXELS_PER_DIAMETER = 2.0
"""A ball smaller than this many pixels has no shape to recognize it by."""

MIN_CEILING_HU = 2000.0
"""No scanner's scale ends below this."""

CLIP_SHOULDER_HU = 10
"""A scale ends where its largest value is commoner than all the values this far below it taken together."""

NEIGHBOUR_COVERAGE = 0.75
"""Below this share of surface seen, a marker is flagged as touched by something large."""


def localize(volume: CTVolume, *, diameter_mm: float, expected: int | None = None) -> Fiducials:
    """Find every ball of ``diameter_mm`` in a scan, its centre (LPS mm) and the centre's covariance (mm^2).

    Raises `UsageError` for a diameter that is not a positive number, `InputError` for one below
    `MIN_VOXELS_PER_DIAMETER` pixels, and `RefusedError` when ``expected`` markers were promised and another
    number was found.
    """
    check_request(diameter_mm, expected)
    _check_resolution(volume, diameter_mm)
    thickness_mm = _thickness(volume)
    ceiling_hu = _ceiling(volume)
    found: list[tuple[BallFit, float]] = []
    rejected: list[Rejected] = []
    for center_mm in detect(volume, diameter_mm).centers_mm:
        if _is_known(center_mm, [fit.center_mm for fit, _ in found], diameter_mm / 2.0):
            continue
        if profile_share(volume, center_mm, diameter_mm, thickness_mm) < MIN_COVERAGE:
            continue
        around = gather(volume, center_mm, diameter_mm / 2.0 + margin_mm(thickness_mm) + diameter_mm / 8.0)
        fit = fit_ball(around, diameter_mm, thickness_mm, ceiling_hu)
        noise_hu = _noise(fit)
        failure = next(failures(Evidence(fit, diameter_mm, thickness_mm, noise_hu)), None)
        if failure is not None:
            rejected.append(Rejected(center_mm, *failure))
        elif not _is_known(fit.center_mm, [other.center_mm for other, _ in found], diameter_mm / 2.0):
            found.append((fit, noise_hu))
    found.sort(key=lambda item: tuple(-item[0].center_mm[::-1]))
    fiducials = tuple(
        _fiducial(f"F{number}", fit, ceiling_hu, thickness_mm) for number, (fit, _) in enumerate(found, start=1)
    )
    result = Fiducials(fiducials, tuple(rejected), diameter_mm, volume.source, volume.voxel_sha256, volume.flags)
    if expected is not None and len(result) != expected:
        raise RefusedError(_explain_count(result, expected))
    return result


def check_request(diameter_mm: float, expected: int | None) -> None:
    """Raise `UsageError` for a diameter or a number of markers that no scan can have."""
    if not (math.isfinite(diameter_mm) and diameter_mm > 0):
        raise UsageError(f"the marker diameter is {diameter_mm}; a positive number of mm is needed")
    if expected is not None and expected < 0:
        raise UsageError(f"{expected} markers were expected; a number from 0 upwards is needed")


def _check_resolution(volume: CTVolume, diameter_mm: float) -> None:
    pixel_mm = max(volume.grid.row_spacing_mm, volume.grid.column_spacing_mm)
    if diameter_mm < MIN_VOXELS_PER_DIAMETER * pixel_mm:
        raise InputError(
            f"a marker of {diameter_mm:g} mm is smaller than {MIN_VOXELS_PER_DIAMETER:g} pixels of this scan "
            f"({pixel_mm:.3f} mm each); scan with a smaller field of view"
        )


def _thickness(volume: CTVolume) -> float:
    """Nominal thickness of the slices; where the file does not say, the usual gap between them."""
    gaps = volume.grid.spacings_mm
    usual = float(np.median(gaps)) if gaps.size else volume.grid.row_spacing_mm
    return volume.grid.thickness_mm or usual


def _ceiling(volume: CTVolume) -> float:
    """Value at which the scan clips, or infinity where its brightest voxels are not clipped."""
    top = float(volume.voxels_hu.max())
    if top < MIN_CEILING_HU:
        return math.inf
    bright = volume.voxels_hu[volume.voxels_hu >= top - CLIP_SHOULDER_HU]
    at_top = int(np.count_nonzero(bright == top))
    return top if at_top > 1 and at_top > len(bright) - at_top else math.inf


def _is_known(center_mm: FloatArray, known_mm: list[FloatArray], radius_mm: float) -> bool:
    return any(float(np.linalg.norm(center_mm - other)) < radius_mm for other in known_mm)


def _noise(fit: BallFit) -> float:
    """Standard deviation of the noise (HU) away from the ball's edge, robust to what else is there."""
    flat = fit.used & ~on_surface(fit.neighbourhood.offsets_mm, fit.theta)
    residuals = fit.residuals_hu[flat]
    return float(1.4826 * np.median(np.abs(residuals))) if residuals.size else 0.0


def _fiducial(label: str, fit: BallFit, ceiling_hu: float, thickness_mm: float) -> Fiducial:
    flags = {
        FiducialFlag.CUT: fit.unseen > 0,
        FiducialFlag.NEIGHBOUR: fit.coverage < NEIGHBOUR_COVERAGE,
        FiducialFlag.CLIPPED: bool((fit.neighbourhood.values_hu[fit.used] >= ceiling_hu).any()),
        FiducialFlag.THICK_SLICES: thickness_mm > fit.diameter_mm / 2.0,
    }
    return Fiducial(
        label=label,
        center_mm=fit.center_mm,
        covariance_mm2=center_covariance(fit),
        diameter_mm=fit.diameter_mm,
        contrast_hu=fit.contrast_hu,
        sigma_mm=fit.sigma_mm,
        coverage=fit.coverage,
        misfit=fit.misfit,
        flags=tuple(flag for flag, raised in flags.items() if raised),
    )


def _explain_count(result: Fiducials, expected: int) -> str:
    found = f"{len(result)} markers of {result.diameter_mm:g} mm were found, {expected} expected"
    if len(result) > expected or not result.rejected:
        return f"{found}; check the diameter and the number"
    near = ", ".join(
        f"({', '.join(f'{x:.1f}' for x in candidate.center_mm)}): {candidate.reason}"
        for candidate in result.rejected[:3]
    )
    return f"{found}; nearest to acceptance were {near}"
