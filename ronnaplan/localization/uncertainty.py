"""The covariance of a fitted center: what the image itself shows of noise and model error.

The center is a weighted sum of voxel values (`BallFit.influence_mm_per_hu`), so what the residuals of one slice do to
it is their weighted sum. Slices that see different tissue are measured apart, so these sums are taken as independent,
and the sum of their squares is the cluster-robust "sandwich" estimate of the covariance (K.-Y. Liang and S. Zeger,
Biometrika 73:13, 1986): noise enters with its correlation within the slice as it is, and so does whatever else differs
from slice to slice, such as streaks and a blur that is not quite Gaussian. Slices whose profiles overlap share their
noise as far as they do (Bartlett's weights, as in W. Newey and K. West, Econometrica 55:703, 1987).

A ball has few slices, which may show too little by chance, so residuals of the same size without any correlation are
added. What all slices share, no residual shows; it is stated from signs of it: streaks about what touches the ball, a
background that slopes, slices that are not small beside the ball, profiles that are bells. The covariance is the sum of
these sources, each with one weight of `WEIGHTS`.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.cells import cell_directions, direction_cells
from ronnaplan.localization.directions import cell_means, edge_depth, just_outside
from ronnaplan.localization.model import has_skin
from ronnaplan.localization.parameters import BACKGROUND, BLUR, CENTER, RADIUS, SHAPE, SLOPES, WIDTH, W
from ronnaplan.localization.refine import BallFit
from ronnaplan.localization.shading import QUANTIZATION_NOISE_HU

MIN_FLAT_VOXELS = 30
"""A zone with fewer voxels says nothing of the noise."""

MIN_FREEDOM = 0.3
"""Share of a zone's voxels that is left at least after each direction has used one for its mean."""

ADAPTED_SLICES = 2.0
"""To so many slices the fit adapts: its center along them, and the profile."""

WEIGHTS = {
    **{"slices": 0.55, "even": 1.1, "streaks": 1.2, "slope": 1.9},
    **{"pole": 1.9e-6, "slanted": 1.2e-6, "least": 0.1e-6},
}
"""How much of each source is error. The first ones would be 1 if the residuals were the whole truth, and independent;
the last two are mm^2. Fitted by `scripts/fit_uncertainty` to the errors on simulated patients and on balls in real
scans, and tested on scanners that were left out."""

PULL_MM, PULL_WIDTH = 0.012, 0.004
"""Standard error along a post that a screw holds: a constant, and a share of the slice profile's width. A screw weakens
the beam more than in proportion, so that the post seems to reach elsewhere, and all markers of a scan err alike; 15 um
were seen in thin slices, 20 in cone beams and 25 in 5 mm slices of one independent simulation, next to nothing in the
phantoms here. It depends on the machine's corrections, which no image tells."""

LAG_MM = 0.005
"""Standard error within the slices where profiles are bells: a flat panel keeps a part of what it saw before, which
displaces what turns past it, all in one sense. Two simulated panels, with 0.5 to 1.5 times the usual lag, moved markers
by 3.7 and 12.7 um; no image tells how much a panel lags."""

HIDDEN_SHADING = 1.4
"""Factor of the covariance where clipping hides how the ball is shaded."""

SIZE_TOLERANCE_MM = 0.06
"""A fitted diameter that is off by no more than this is the stated one: kernels that are not Gaussian make 0.04 mm."""


def center_covariance(
    fit: BallFit, noise_hu: float, excess_mm: float = 0.0, *, is_pulled: bool = False
) -> FloatArray:
    """Covariance (3, 3) of the fitted center in LPS, mm^2: noise (``noise_hu``), model error and what may cover it.

    ``excess_mm`` is the fitted minus the stated diameter; ``is_pulled`` says that metal lies beyond what touches it.
    """
    total = sum((WEIGHTS[name] * source for name, source in sources(fit, noise_hu).items()), np.zeros((3, 3)))
    if not fit.is_shaded:
        total *= HIDDEN_SHADING
    total += LAG_MM**2 * _bell(fit) * np.diag([1.0, 1.0, 0.0])
    if is_pulled:
        axis = attached_axis(fit)
        total += (PULL_MM**2 + (PULL_WIDTH * float(fit.theta[WIDTH])) ** 2) * np.outer(axis, axis)
    if is_off_size(excess_mm):
        total += _one_sided_covariance(fit, excess_mm)
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ total @ axes
    return (rotated + rotated.T) / 2.0


def sources(fit: BallFit, noise_hu: float) -> dict[str, FloatArray]:
    """What may move the center, by the names of `WEIGHTS`: covariances (3, 3) along u, v, w, in mm^2 or without a unit.

    ``slices``: what each slice's residuals do to it; ``even``: what they would do if they were uncorrelated within the
    slices;
    ``streaks``: streaks of the size seen just outside the ball that displace its edge along the axis of what touches
    it, as a screw casts them along the post; ``slope``: a background that slopes across the blur, as streaks do;
    ``pole``: a profile whose shape the few slices of a small ball do not tell, by the depth of the ball's pole in a
    slice; ``slanted``: bell-shaped profiles, those of a helix or a cone beam, whose slanted rays and moving table
    displace what they show; ``least``: what stays in any scan.
    """
    influence = fit.influence_mm_per_hu[fit.used]
    of_slices, shared, mean_square = _slices(fit)
    apart = len(of_slices) / float(shared.sum(axis=1).max(initial=1.0))
    freedom = apart / max(apart - ADAPTED_SLICES, 0.5)  # a few slices are fitted more closely than they are true
    blur_mm, width_mm = float(fit.theta[BLUR]), float(fit.theta[WIDTH])
    sloping_mm = np.array([blur_mm, blur_mm, width_mm]) * fit.theta[SLOPES] / fit.contrast_hu
    streaks_mm = 0.0 if has_skin(fit.theta) else _streaks_hu(fit, noise_hu) * blur_mm / fit.contrast_hu
    axis = attached_axis(fit)
    depth_mm = width_mm**2 / float(fit.theta[RADIUS])
    return {
        "slices": freedom * of_slices.T @ shared @ of_slices,
        "even": mean_square * influence.T @ influence,
        "streaks": streaks_mm**2 * (np.outer(axis, axis) if axis.any() else np.eye(3) / 3.0),
        "slope": np.outer(sloping_mm, sloping_mm),
        "pole": np.diag([0.0, 0.0, depth_mm**2]),
        "slanted": _bell(fit) * np.eye(3),
        "least": np.eye(3),
    }


def _bell(fit: BallFit) -> float:
    """1 where the slice profile is a bell, as a helix and a cone beam have it; 0 where it is a box."""
    return min(float(fit.theta[SHAPE]), 1.0) ** 4


def cramer_rao_bound(fit: BallFit, noise_hu: float) -> FloatArray:
    """Least covariance (3, 3) in LPS, mm^2, of any unbiased fit of this model to the whole ball's voxels.

    For uncorrelated noise of ``noise_hu``, and as if nothing touched the ball (S. Kay, Fundamentals of
    Statistical Signal Processing: Estimation Theory, 1993, section 3.9).
    """
    information = fit.jacobian.T @ fit.jacobian / noise_hu**2
    bound = np.linalg.pinv(information, hermitian=True)[:3, :3]
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ bound @ axes
    return rotated


def noise_level(fit: BallFit) -> float:
    """Standard deviation of the noise (HU) where the ball and its surroundings are flat.

    Robust to streaks (each direction's mean is taken off) and to air at the bottom of the scale (only the upper
    half of the values counts); the quieter of inside and outside, for what disturbs only adds.
    """
    depth, blur = edge_depth(fit.neighbourhood.offsets_mm, fit.theta)
    cells = direction_cells(fit.neighbourhood.offsets_mm - fit.theta[CENTER])
    measured = fit.jacobian[:, BACKGROUND] != 0.0  # clipped voxels have no noise
    flat = fit.used & measured & (np.abs(depth) > 2.0 * blur)
    levels = []
    for zone in (flat & (depth < 0), flat & (depth > 0)):
        if np.count_nonzero(zone) < MIN_FLAT_VOXELS:
            continue
        means, seen = cell_means(fit.residuals_hu, cells, zone)
        left_over = (fit.residuals_hu - means[cells])[zone]
        middle = np.median(left_over)
        spread = 1.4826 * float(np.median(left_over[left_over >= middle] - middle))
        freedom = max(1.0 - np.count_nonzero(seen) / len(left_over), MIN_FREEDOM)
        levels.append(spread / float(np.sqrt(freedom)))
    return max(min(levels, default=_rms(fit.residuals_hu[fit.used])), QUANTIZATION_NOISE_HU)


def _slices(fit: BallFit) -> tuple[FloatArray, FloatArray, float]:
    """What each slice's residuals do to the center (K, 3) in mm, and which part of their tissue slices share (K, K).

    And the mean square of the residuals (HU^2), each times what it shares with those of its own column of voxels: noise
    that slices share counts as often, what alternates from slice to slice cancels.
    """
    residuals, indices = fit.residuals_hu[fit.used], fit.neighbourhood.indices[fit.used]
    _, first, slices = np.unique(indices[:, 0], return_index=True, return_inverse=True)
    sums = np.zeros((len(first), 3))
    np.add.at(sums, slices, fit.influence_mm_per_hu[fit.used] * residuals[:, np.newaxis])
    places_mm = fit.neighbourhood.offsets_mm[fit.used][first, W]
    shared = np.maximum(1.0 - np.abs(places_mm[:, np.newaxis] - places_mm) / fit.theta[WIDTH], 0.0)
    rows, columns = (indices[:, 1:] - indices[:, 1:].min(axis=0, initial=np.iinfo(np.intp).max)).T
    images = np.zeros((len(first), rows.max(initial=0) + 1, columns.max(initial=0) + 1))
    images[slices, rows, columns] = residuals
    flat = images.reshape(len(first), -1)
    return sums, shared, float(np.sum(shared * (flat @ flat.T))) / max(len(residuals), 1)


def attached_axis(fit: BallFit) -> FloatArray:
    """Unit vector (3,) along u, v, w towards what touches the ball; zero where nothing does."""
    toward = cell_directions()[fit.verdict.state == 0].sum(axis=0)
    length = float(np.linalg.norm(toward))
    axis: FloatArray = toward / length if length > 0.0 else np.zeros(3)
    return axis


def _streaks_hu(fit: BallFit, noise_hu: float) -> float:
    """Root mean square (HU) of what the fit leaves over just outside the ball, direction by direction, beyond noise."""
    zone = fit.used & just_outside(fit.neighbourhood.offsets_mm, fit.theta)
    cells = direction_cells(fit.neighbourhood.offsets_mm - fit.theta[CENTER])
    means, seen = cell_means(fit.residuals_hu, cells, zone)
    excess = float(np.sum(means[cells[zone]] ** 2)) - int(np.count_nonzero(seen)) * noise_hu**2
    return float(np.sqrt(max(excess, 0.0) / max(int(np.count_nonzero(zone)), 1)))


def is_off_size(excess_mm: float) -> bool:
    """Whether a diameter that is off by ``excess_mm`` says that something is not as stated."""
    return abs(excess_mm) > SIZE_TOLERANCE_MM


def _one_sided_covariance(fit: BallFit, excess_mm: float) -> FloatArray:
    """Covariance (3, 3) along u, v, w of what makes a marker look larger on one side, wherever that is.

    A film over one half looks like a larger ball whose center lies half its thickness aside; and where something hides
    a side, a wrong size moves the center along it.
    """
    aside: FloatArray = (excess_mm / 2.0) ** 2 * (
        np.eye(3) / 3.0 + np.outer(fit.center_by_radius, fit.center_by_radius)
    )
    return aside


def _rms(values: FloatArray) -> float:
    return max(float(np.sqrt(np.mean(values**2))), QUANTIZATION_NOISE_HU) if values.size else 1.0
