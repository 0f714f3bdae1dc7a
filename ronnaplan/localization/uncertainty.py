"""The covariance of a fitted centre: what the image itself shows of noise and model error.

The centre is a weighted sum of voxel values (`BallFit.influence_mm_per_hu`), so what the residuals of one slice do to
it is their weighted sum. Slices are measured apart, so these sums are taken as independent, and the sum of their
squares is the cluster-robust "sandwich" estimate of the covariance (K.-Y. Liang and S. Zeger, Biometrika 73:13, 1986):
noise enters with its correlation within the slice as it is, and so does whatever else differs from slice to slice,
such as streaks and a blur that is not quite Gaussian.

What all slices share, no residual shows. It is stated from signs of it: what touches the ball errs along its axis,
with the more weight the more the surroundings are streaked; a background that slopes never just slopes; slices that
are not small beside the ball. How much each stands for was fitted to the errors on simulated patients, which
`docs/localization.md` names.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.directions import cell_means, edge_depth, just_outside
from ronnaplan.localization.model import has_skin
from ronnaplan.localization.neighbourhood import cell_directions, direction_cells
from ronnaplan.localization.parameters import BACKGROUND, BLUR, CENTER, RADIUS, SHAPE, SLOPES, WIDTH, W
from ronnaplan.localization.refine import BallFit
from ronnaplan.localization.shading import QUANTIZATION_NOISE_HU

MIN_FLAT_VOXELS = 30
"""A zone with fewer voxels says nothing of the noise."""

MIN_FREEDOM = 0.3
"""Share of a zone's voxels that is left at least after each direction has used one for its mean."""

SEEN_SHARE = 0.5
CORRELATION_POWER = 0.75
NOISE_POWER = 0.4
"""How much of what the slices show is error. It grows with the correlation within the slice: what is correlated over a
sector is also so over distances that a ball is too small to show. And with the share of noise in the residuals: the
rest is mostly a blur that is not quite Gaussian, alike on opposite sides."""

LEAST_NOISE_SHARE = 0.01
"""Noise is counted as at least this share of the residuals."""

SECTORS = 8
"""Each slice of the ball is cut into so many sectors to see the correlation within it."""

NEIGHBOUR_BOUNDS = (-0.5, 0.3)
"""Neighbouring slices that err alike add their correlation, within these bounds: a few slices tell it roughly."""

EVEN_SHARE = 0.7
"""How much is added of what residuals of the same size without any correlation would do: the ball's few slices may
show too little by chance."""

SHARED_SLICES = 1.0
"""Within the slice plane the error is shared between the axes as evenly strong noise would share it, with the weight
of so many slices: by chance a few slices show too little along one of them."""

SLOPE_ERROR = 3.5
"""Standard error along a sloping background, as a multiple of slope x blur / contrast (across the slices their
thickness is the blur): a streak never just slopes."""

AXIS_SHARE = 0.36
AXIS_STREAK = 0.9
"""Variance along the axis of what touches the ball: as a share of all that the slices, or the sectors if they show
less, do to the centre; and, where that is not fitted as skin is, as the square of so many times streaks x blur /
contrast: a screw casts its streaks along the post."""

AXIS_WIDTH = 0.0015
"""Standard error along that axis, as a share of the slice profile's width: a screw that fills a part of a slice
weakens the beam more than in proportion, so that the post seems to reach elsewhere; all markers of a scan err alike."""

HIDDEN_SHADING = 1.4
"""Factor of the covariance where clipping hides how the ball is shaded."""

POLE_ERROR = 0.0013
"""Standard error across the slices, as a share of thickness^2 / radius, the depth of the ball's pole in a slice: the
slices' profile is not quite a box."""

SLANTED_ERROR_MM = 0.0015
"""Standard error per axis where the slice profile is a bell: a helix or a cone beam, whose slanted rays, moving table
and lagging panel displace what they show without a trace in the image (physically simulated helices and cone beams)."""

SIZE_TOLERANCE_MM = 0.06
"""A fitted diameter that is off by no more than this is the stated one: kernels that are not Gaussian make 0.04 mm."""

LEAST_ERROR_MM = 0.00005
"""Standard error per axis that stays in any scan: finite tables."""

SMALLEST = 1e-30
"""Keeps ratios of squares finite where a fit leaves nothing over."""


def center_covariance(fit: BallFit, noise_hu: float, excess_mm: float = 0.0) -> FloatArray:
    """Covariance (3, 3) of the fitted centre in LPS, mm^2: noise (``noise_hu``), model error and what may cover it.

    ``excess_mm`` is the fitted minus the stated diameter.
    """
    moved = _Moved.by(fit)
    total = _seen_covariance(fit, moved, noise_hu) + _axis_covariance(fit, moved, noise_hu)
    total += _unseen_covariance(fit)
    if not fit.is_shaded:
        total *= HIDDEN_SHADING
    if is_off_size(excess_mm):
        total += _one_sided_covariance(fit, excess_mm)
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ total @ axes
    return (rotated + rotated.T) / 2.0


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


@dataclass(frozen=True)
class _Moved:
    """What the residuals do to the centre, in mm: of each slice (K, 3) and of each of its `SECTORS` (8 K, 3).

    Slices that see the same tissue share its noise: ``shared`` (K, K) says which part of their profiles overlaps, and
    ``overlap`` how many slices see one place.
    """

    slices: FloatArray
    sectors: FloatArray
    shared: FloatArray
    overlap: float

    @classmethod
    def by(cls, fit: BallFit) -> _Moved:
        moves = fit.influence_mm_per_hu[fit.used] * fit.residuals_hu[fit.used, np.newaxis]
        _, first, slices = np.unique(
            fit.neighbourhood.indices[fit.used, 0], return_index=True, return_inverse=True
        )
        places_mm = fit.neighbourhood.offsets_mm[fit.used][first, W] if first.size else np.zeros(1)
        apart = np.abs(places_mm[:, np.newaxis] - places_mm) / fit.theta[WIDTH]
        shared = np.maximum(1.0 - apart, 0.0)
        sectors = _sums(moves, slices * SECTORS + _sectors(fit))
        return cls(_sums(moves, slices), sectors, shared, float(shared.sum(axis=1).max(initial=1.0)))

    @property
    def size_mm2(self) -> float:
        """All that the slices do, squared and summed with what they share."""
        return float(np.sum(self.slices * (self.shared @ self.slices)))

    @property
    def alike(self) -> float:
        """Correlation between neighbours that share nothing."""
        step = int(np.ceil(self.overlap))
        return float(np.sum(self.slices[step:] * self.slices[:-step])) / max(
            float(np.sum(self.slices**2)), SMALLEST
        )


def _seen_covariance(fit: BallFit, moved: _Moved, noise_hu: float) -> FloatArray:
    """Covariance (3, 3) along u, v, w from what the residuals do to the centre, slice by slice."""
    influence, residuals = fit.influence_mm_per_hu[fit.used], fit.residuals_hu[fit.used]
    mean_square = max(float(residuals @ residuals) / max(len(residuals), 1), SMALLEST)
    even = influence.T @ influence * mean_square
    correlation = max(float(np.sum(moved.sectors**2)), SMALLEST) / max(float(np.trace(even)), SMALLEST)
    alike = np.clip(2.0 * moved.alike, *NEIGHBOUR_BOUNDS)
    noise_share = np.clip(noise_hu**2 / mean_square, LEAST_NOISE_SHARE, 1.0)
    seen = SEEN_SHARE * correlation**CORRELATION_POWER * noise_share**NOISE_POWER * (1.0 + alike)
    apart = len(moved.slices) / moved.overlap
    freedom = apart / max(apart - 2.0, 1.0)  # the fit has adapted to a few slices more than to many
    summed = moved.slices.T @ moved.shared @ moved.slices
    drawn = _shared_in_plane(summed, even, SHARED_SLICES / (apart + SHARED_SLICES))
    covariance: FloatArray = seen * freedom * drawn + EVEN_SHARE * moved.overlap * even
    return covariance


def _axis_covariance(fit: BallFit, moved: _Moved, noise_hu: float) -> FloatArray:
    """Covariance (3, 3) along u, v, w of errors along the axis of what touches the ball."""
    toward = fit.theta[-3:] if has_skin(fit.theta) else cell_directions()[fit.verdict.state == 0].sum(axis=0)
    variance = AXIS_SHARE * min(moved.size_mm2, moved.overlap * float(np.sum(moved.sectors**2)))
    if not has_skin(fit.theta):
        variance += (AXIS_STREAK * _streaks_hu(fit, noise_hu) * fit.sigma_mm / fit.contrast_hu) ** 2
    variance += (AXIS_WIDTH * float(fit.theta[WIDTH])) ** 2
    length = float(np.linalg.norm(toward))
    direction = np.outer(toward, toward) / length**2 if length > 0.0 else np.eye(3) / 3.0  # touched from anywhere
    covariance: FloatArray = variance * direction
    return covariance


def _streaks_hu(fit: BallFit, noise_hu: float) -> float:
    """Root mean square (HU) of what the fit leaves over just outside the ball, direction by direction, beyond noise."""
    zone = fit.used & just_outside(fit.neighbourhood.offsets_mm, fit.theta)
    cells = direction_cells(fit.neighbourhood.offsets_mm - fit.theta[CENTER])
    means, seen = cell_means(fit.residuals_hu, cells, zone)
    excess = float(np.sum(means[cells[zone]] ** 2)) - int(np.count_nonzero(seen)) * noise_hu**2
    return float(np.sqrt(max(excess, 0.0) / max(int(np.count_nonzero(zone)), 1)))


def _sectors(fit: BallFit) -> NDArray[np.intp]:
    """In which sector of its slice each used voxel lies."""
    offsets = fit.neighbourhood.offsets_mm[fit.used] - fit.theta[CENTER]
    turn = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2.0 * np.pi) + 0.5
    sectors: NDArray[np.intp] = (turn * SECTORS).astype(np.intp) % SECTORS
    return sectors


def _sums(moves: FloatArray, groups: NDArray[np.intp]) -> FloatArray:
    """Sum of ``moves`` (N, 3) in each of the ``groups`` (N,)."""
    sums = np.zeros((int(groups.max(initial=0)) + 1, 3))
    np.add.at(sums, groups, moves)
    return sums


def _shared_in_plane(covariance: FloatArray, even: FloatArray, share: float) -> FloatArray:
    """Draw u and v of ``covariance`` (3, 3) by ``share`` towards what ``even`` noise would do to them."""
    drawn = (1.0 - share) * covariance
    scale = np.trace(covariance[:2, :2]) / max(float(np.trace(even[:2, :2])), SMALLEST)
    drawn[:2, :2] += share * scale * even[:2, :2]
    drawn[2, 2] = covariance[2, 2]
    return drawn


def _unseen_covariance(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) along u, v, w from a sloping background and from slices that are not small beside the ball."""
    radius_mm, blur_mm, thickness_mm = fit.theta[[RADIUS, BLUR, WIDTH]]
    sloping_mm = SLOPE_ERROR * np.array([blur_mm, blur_mm, thickness_mm]) * fit.theta[SLOPES] / fit.contrast_hu
    own_mm = np.array([0.0, 0.0, POLE_ERROR * thickness_mm**2 / radius_mm])
    slanted_mm = SLANTED_ERROR_MM * min(float(fit.theta[SHAPE]), 1.0) ** 2
    covariance: FloatArray = np.outer(sloping_mm, sloping_mm)
    covariance += np.diag(own_mm**2 + slanted_mm**2 + LEAST_ERROR_MM**2)
    return covariance


def is_off_size(excess_mm: float) -> bool:
    """Whether a diameter that is off by ``excess_mm`` says that something is not as stated."""
    return abs(excess_mm) > SIZE_TOLERANCE_MM


def _one_sided_covariance(fit: BallFit, excess_mm: float) -> FloatArray:
    """Covariance (3, 3) along u, v, w of what makes a marker look larger on one side, wherever that is.

    A film over one half looks like a larger ball whose centre lies half its thickness aside; and where something hides
    a side, a wrong size moves the centre along it.
    """
    aside: FloatArray = (excess_mm / 2.0) ** 2 * (
        np.eye(3) / 3.0 + np.outer(fit.center_by_radius, fit.center_by_radius)
    )
    return aside


def _rms(values: FloatArray) -> float:
    return max(float(np.sqrt(np.mean(values**2))), QUANTIZATION_NOISE_HU) if values.size else 1.0
