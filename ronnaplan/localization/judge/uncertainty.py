"""The covariance of a fitted center: what the image itself shows of noise and model error.

The center is a weighted sum of voxel values (`BallFit.influence_mm_per_hu`), so what the residuals of some voxels do to
it is their weighted sum. Slices that see different tissue are measured apart, so their sums are taken as independent,
and the sum of their squares is the cluster-robust "sandwich" estimate of the covariance (K.-Y. Liang and S. Zeger,
Biometrika 73:13, 1986): noise enters with its correlation as it is, and so does whatever else differs from one to the
next, such as streaks and a blur that is not quite Gaussian. Few sums tell a covariance badly (A. Cameron and D. Miller,
Journal of Human Resources 50:317, 2015): where few slices show a ball, the octants of each tell more. But what
neighbouring octants share, as they do coarse grain, only a whole slice holds. So the larger of both estimates is
stated. Slices whose profiles overlap share their noise as the profile's autocorrelation says (W. Newey and K. West,
Econometrica 55:703, 1987, with a box's; D. Andrews, Econometrica 59:817, 1991, with others).

What all slices share, no residual along them shows: a head that moves, a panel that lags, streaks, a cone of rays. All
of these displace an edge by the direction in which it faces. The first harmonic of that direction displaces the center,
and no fit tells it from a ball elsewhere. The odd harmonics from the third on bend the outline, as no still ball's is
(`judge.motion`), and are about as large. So these are stated as error, the marker's own and those usual in its scan.
Slices that are not small beside the ball hide how its poles end. The covariance is the sum of these sources, each with
one weight of `WEIGHTS`.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.grid import SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import is_off_size
from ronnaplan.localization.fit.algebra import inverse
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.neighbourhood import first_of_each
from ronnaplan.localization.fit.parameters import (
    BLUR,
    CENTER,
    LEAST_SPREAD_MM2,
    RADIUS,
    SHAPE,
    WIDTH,
    U,
    V,
    W,
    profile_half_mm,
)
from ronnaplan.localization.fit.shading import UNEVEN
from ronnaplan.localization.judge.motion import Movement

ADAPTED_SLICES = 2.0
"""To so many slices the fit adapts: its center along them, and the profile."""

OCTANTS = 8
"""The residuals of a slice are summed by so many directions about the center."""

PROFILE_SAMPLES = 129
"""A slice's profile is correlated with itself at so many places."""

WEIGHTS = {"slices": 0.64, "odd": 1.0, "pole": 1.4e-6, "least": 0.31e-6}
"""How much of each source is error. The first would be 1 if it were the whole truth, and independent; the last is in
mm^2. Fitted by `scripts/fit_uncertainty` to the errors on simulated patients and on balls in real scans, and tested on
scanners that were left out. But for ``odd``: what a head that moves along a line in a turn adds to the third harmonic
is as much as it moves the center from its mean place."""

FACE_PULL_MM = 0.01
"""Standard error along each axis of a ball that is embedded near a face: where rays run along the face, cells that see
both sides of it add up what they receive, and streak beside it. 8 to 15 um were left across a plate, 9 um along it."""

SCREW_PULL_MM, SCREW_PULL_WIDTH = 0.012, 0.004
"""Standard error along a post that a screw holds, and of a ball that is metal itself: a constant, and a share of the
slice profile's width. A screw weakens the beam more than in proportion, so that the post seems to reach elsewhere, and
all markers of a scan err alike; 15 um were seen in thin slices, 20 in cone beams and 25 in 5 mm slices of one
independent simulation, next to nothing in three others and in the phantoms here. Cells and focal spots of 1.4 mm make
so much in another one: how wide they are no image tells."""

POST_PULL_MM, POST_ASIDE = 0.005, 0.35
"""The same where what holds the ball is no metal, and the share of it across that direction, as the head pulls, too.
Balls on plastic posts were pulled by 7 to 11 um towards the head in a simulator made apart, half of it by the post and
half by the head."""

STILL_PULLED, STILL_HARDENED = 0.5, 0.4
"""Where what a head does to the image is made good (`hardened`), this share of these is stated, and the second share of
how far the center was moved by it: of 2.5 to 20 um that were made good of plastic, glass and alumina in two independent
simulations, 0.38 and 0.44 RMS are left. Of the first all is stated of hollow balls."""

STILL_UNEVEN = 0.3
"""So much of how far an uneven filling had moved the center is stated where it is made good: 0.12 to 0.25 of it was
left in three simulated scans."""

NO_PULL: Final = np.zeros((3, 3))
"""Covariance (3, 3), mm^2, where nothing draws a center."""
WITHIN: Final = np.diag([1.0, 1.0, 0.0])
"""The directions within the slices, of u, v, w."""

LAG_MM, ROWS_MM = 0.006, 0.003
"""Standard error within the slices where the blur is a flat panel's (`by_panel`): it keeps a part of what it saw
before, which displaces all that turns past it in one sense, and bends it little. Nine simulated panels here moved all
markers of a scan by 3 to 7 um, two of another simulator by 3.7 and 12.7; no image tells how much a panel lags. Many
rows, as of helices and photon counting, blur alike, but do not lag. There 2.3 um are likeliest by seven kinds of scan
of three simulators, 0 and 3.5 by either of the two that have most of them. The second is a little more, for pictures of
panels in other voxels: with 2 um, 14 of 20 balls of one scan were within 95 %, with 3 um 19."""

HIDDEN_SHADING = 0.001
"""Standard error, as a share of the radius, where clipping hides how the ball is shaded. The head hardens the beam on
one side of it, and the larger it is, the more its two sides differ: 4 to 6 um were seen in balls of 8 mm, nothing in
those of 3 mm."""

NEIGHBOUR_COVERAGE = 0.75
"""Below this share of surface seen, a marker is flagged as touched by something large, and its center goes with its
size."""

ASIDE, MOST_ASIDE = 0.5, 0.75
"""A film that thins out towards the other side displaces a fitted center by the first share of what it adds to the
diameter; one over half the ball, or a strip over one side, by the second. That is stated where no flag tells of it."""


def center_covariance(
    fit: BallFit, moved: Movement, pull_mm2: FloatArray = NO_PULL, excess_mm: float = 0.0
) -> FloatArray:
    """Covariance (3, 3) of the fitted center in LPS, mm^2: noise, model error and what may cover it.

    ``moved`` is what `motion.movement` finds, ``pull_mm2`` (3, 3) what is stated in LPS of all that draws a center,
    ``excess_mm`` the fitted minus the stated diameter.
    """
    total = sum((WEIGHTS[name] * source for name, source in sources(fit, moved).items()), np.zeros((3, 3)))
    total += hidden_shading_mm2(fit) * np.eye(3)
    total += UNEVEN**2 / 3.0 * fit.center_by_layer @ fit.center_by_layer.T
    if fit.by_part_mm2 is not None:
        total += fit.by_part_mm2
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ total @ axes
    if fit.neighbourhood.evened_mm is not None:
        left_mm = STILL_UNEVEN * fit.neighbourhood.evened_mm
        rotated += np.outer(left_mm, left_mm)
    if is_off_size(excess_mm):
        rotated += excess_mm**2 * by_excess(fit)
    elif fit.coverage < NEIGHBOUR_COVERAGE:
        rotated += excess_mm**2 * by_size(fit)
    return (rotated + rotated.T) / 2.0 + pull_mm2


def pulled_mm2(fit: BallFit, axis: FloatArray, *, is_metal: bool) -> FloatArray:
    """Covariance (3, 3) in LPS, mm^2, by what holds a ball in the direction ``axis`` (3,) of `held.held_by`.

    ``is_metal`` says whether that is metal, or may be the ball itself.
    """
    along = np.outer(axis, axis)
    if is_metal:
        pull_mm2: FloatArray = (SCREW_PULL_MM**2 + (SCREW_PULL_WIDTH * float(fit.theta[WIDTH])) ** 2) * along
    else:
        across = float(axis @ axis) * np.eye(3) - along
        pull_mm2 = POST_PULL_MM**2 * (along + POST_ASIDE**2 * across)
    if fit.made_good_mm is None:
        return pull_mm2
    left_mm = STILL_HARDENED * fit.made_good_mm
    # Hollow balls of thin walls stay 8 to 11 um off on their posts, of 8 to 13 um before.
    still_pulled = STILL_PULLED if fit.prior.layer_mm == 0.0 else 1.0
    left: FloatArray = still_pulled**2 * pull_mm2 + np.outer(left_mm, left_mm)
    return left


def near_faces_mm2(fit: BallFit) -> FloatArray:
    """Covariance (3, 3), mm^2, by the faces of what a ball is embedded in, where they are near."""
    pull_mm = FACE_PULL_MM if fit.neighbourhood.ending_share > 0.0 else 0.0
    return pull_mm**2 * np.eye(3)


def lag_mm(grid: SliceGrid) -> float:
    """Standard error (mm) within the slices for a blur that is wholly a panel's, in the voxels of ``grid``."""
    return LAG_MM if grid.may_be_a_panels else ROWS_MM


def lagging_mm2(share: float, error_mm: float, axes: FloatArray) -> FloatArray:
    """Covariance (3, 3) in LPS, mm^2, of `lag_mm` for a ``share`` of `by_panel`; ``axes`` (3, 3) are u, v, w in LPS."""
    within: FloatArray = axes.T @ WITHIN @ axes
    return error_mm**2 * share * within


def streaked_mm2(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) in LPS, mm^2, of a ball in the streaks of metal beside it.

    They make its background slope, but never are a slope alone. What else they do leaves little trace: they draw the
    center about as far as the slope would that is made good.
    """
    moved_mm = fit.center_by_slopes_mm @ fit.neighbourhood.axes
    return np.outer(moved_mm, moved_mm)


def sources(fit: BallFit, moved: Movement) -> dict[str, FloatArray]:
    """What may move the center, by the names of `WEIGHTS`: covariances (3, 3) along u, v, w, in mm^2 or without a unit.

    ``slices``: what the residuals of slices or their octants do to it; ``odd``: what bends its outline oddly;
    ``pole``: a profile whose shape the few slices of a small ball do not tell, by the depth of the ball's pole in a
    slice; ``least``: what stays in any scan.
    """
    depth_mm = float(fit.theta[WIDTH]) ** 2 / float(fit.theta[RADIUS])
    return {
        "slices": by_slices(fit),
        "odd": np.diag(moved.odd_mm2),
        "pole": np.diag([0.0, 0.0, depth_mm**2]),
        "least": np.eye(3),
    }


def hidden_shading_mm2(fit: BallFit) -> float:
    """Variance (mm^2), in every direction, of a ball whose shading is hidden; 0 of others."""
    return 0.0 if fit.is_shaded else (HIDDEN_SHADING * float(fit.theta[RADIUS])) ** 2


def by_excess(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) in LPS for each mm^2 by which a diameter is off: something may lie on one side of the marker.

    Where that is, is not known.
    """
    aside: FloatArray = ASIDE**2 / 3.0 * np.eye(3) + by_size(fit)
    return aside


def by_size(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) in LPS for each mm^2 by which a diameter is off, whatever made it so.

    Where something hides a side of a ball, a wrong size moves the center along it.
    """
    toward = fit.center_by_radius / 2.0 @ fit.neighbourhood.axes
    return np.outer(toward, toward)


def cramer_rao_bound(fit: BallFit, noise_hu: float) -> FloatArray:
    """Least covariance (3, 3) in LPS, mm^2, of any unbiased fit of this model to the whole ball's voxels.

    For uncorrelated noise of ``noise_hu``, and as if nothing touched the ball (S. Kay, Fundamentals of
    Statistical Signal Processing: Estimation Theory, 1993, section 3.9).
    """
    bound = inverse(fit.jacobian.T @ fit.jacobian / noise_hu**2)[:3, :3]
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ bound @ axes
    return rotated


def by_slices(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) along u, v, w from what the residuals of slices, or of their octants, do to the center."""
    kept = np.flatnonzero(fit.used)
    first, offsets_mm = first_of_each(fit.neighbourhood.slices[kept]), fit.neighbourhood.offsets_mm[kept]
    told = fit.influence_mm_per_hu.take(kept, axis=0) * fit.residuals_hu.take(kept)[:, np.newaxis]
    layers = np.repeat(np.arange(len(first)), np.diff(first, append=len(kept)))
    places = octants(offsets_mm - fit.theta[CENTER]) * len(first) + layers
    sums = np.stack([np.bincount(places, along, OCTANTS * len(first)) for along in told.T], axis=-1)
    sums = sums.reshape(OCTANTS, len(first), 3)
    places_mm = offsets_mm[first, W]
    shared = shared_noise(
        np.abs(places_mm[:, np.newaxis] - places_mm), float(fit.theta[WIDTH]), float(fit.theta[SHAPE])
    )
    apart = len(first) / float(shared.sum(axis=1).max(initial=1.0))
    freedom = apart / max(apart - ADAPTED_SLICES, 0.5)  # a few slices are fitted more closely than they are true
    whole = sums.sum(axis=0)
    return freedom * larger((np.swapaxes(sums, 1, 2) @ shared @ sums).sum(axis=0), whole.T @ shared @ whole)


def larger(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) that is, in every direction, no smaller than either: what one has more is added."""
    more, ways = np.linalg.eigh(one - other)
    covariance: FloatArray = other + (ways * np.maximum(more, 0.0)) @ ways.T
    return covariance


def octants(offsets_mm: FloatArray) -> NDArray[np.intp]:
    """In which octant of its slice each offset (N, 3) along u, v, w from the center lies (N,)."""
    u_mm, v_mm = offsets_mm[:, U], offsets_mm[:, V]
    octant: NDArray[np.intp] = 4 * (u_mm < 0.0) + 2 * (v_mm < 0.0) + (np.abs(u_mm) < np.abs(v_mm))
    return octant


def shared_noise(distances_mm: FloatArray, width_mm: float, shape: float) -> FloatArray:
    """How far slices that are ``distances_mm`` apart share their noise: the slice profile's autocorrelation.

    A box's is Bartlett's triangle.
    """
    along = np.linspace(-1.0, 1.0, PROFILE_SAMPLES)
    profile = (1.0 - along**2) ** shape
    correlated = np.correlate(profile, profile, "full")[PROFILE_SAMPLES - 1 :]
    halves = distances_mm / profile_half_mm(width_mm, shape)
    shared: FloatArray = np.interp(halves, along + 1.0, correlated / correlated[0], right=0.0)
    return shared


def by_panel(theta: FloatArray) -> float:
    """How much the blur is that of a flat panel, 0 to 1: no box along the slices' normal, and no wider than in them."""
    across_mm = math.sqrt(float(theta[WIDTH]) ** 2 / 12.0 + LEAST_SPREAD_MM2)
    return (min(float(theta[SHAPE]), 1.0) * min(float(theta[BLUR]) / across_mm, 1.0)) ** 4
