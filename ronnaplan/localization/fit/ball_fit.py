"""What a fit tells of a ball: its parameters, what informed them, what is left over, and what moves its center."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import inverse
from ronnaplan.localization.fit.depth import edge_depth, on_surface
from ronnaplan.localization.fit.descent import Prior
from ronnaplan.localization.fit.directions import Verdict
from ronnaplan.localization.fit.model import METAL_CONTRAST_HU, has_streaks
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.parameters import BACKGROUND, BLUR, CENTER, CONTRAST, RADIUS, SLOPES
from ronnaplan.localization.fit.residuals import layer_jacobian, residuals_and_jacobian
from ronnaplan.localization.fit.shading import PLATEAU_SHARE, Shading, shaded


@dataclass(frozen=True)
class BallFit:
    """A ball fitted to the N voxels of its neighbourhood by P parameters."""

    neighbourhood: Neighbourhood
    theta: FloatArray
    """The model's `PARAMETERS` (P,), then `STREAK_PARAMETERS` of metal and `SKIN_PARAMETERS` of what lies on something.

    The center is relative to the neighbourhood's origin, along u, v, w."""
    used: NDArray[np.bool_]
    """Which voxels (N,) informed the fit."""
    residuals_hu: FloatArray
    """Data minus model and shading (N,)."""
    unshaded_hu: FloatArray
    """Data minus model alone (N,), where the center was before the shading moved it."""
    jacobian: FloatArray
    """The model's derivatives (N, P), there, too."""
    influence_mm_per_hu: FloatArray
    """How far one HU at each voxel moves the center (N, 3)."""
    aside_mm: FloatArray
    """How far a cavity lies aside (3,), as the shading tells; zero where that was not asked for."""
    is_shaded: bool
    """Whether the shading was asked for."""
    verdict: Verdict
    converged: bool
    prior: Prior
    made_good_mm: FloatArray | None = None
    """How far the center was moved (3,), in LPS, by making good what a head does to the image; None if nothing was."""
    by_part_mm2: FloatArray | None = None
    """How well the center is known (3, 3), along u, v, w, where a part of the ball told it better than the whole.

    The rest is pulled by a screw that crosses its slices (`judge.crossed`), or by a socket's rim (`judge.rim`)."""
    drawn: BallFit | None = None
    """The fit by the whole of a ball in a socket, whose rim draws it."""

    @property
    def center_mm(self) -> FloatArray:
        """Center (3,) in LPS."""
        center: FloatArray = self.neighbourhood.origin_mm + self.theta[CENTER] @ self.neighbourhood.axes
        return center

    @property
    def ceiling_hu(self) -> float:
        """Value at which the scan clips."""
        return self.neighbourhood.ceiling_hu

    @property
    def diameter_mm(self) -> float:
        """Fitted diameter."""
        return float(2.0 * self.theta[RADIUS])

    @property
    def sigma_mm(self) -> float:
        """Fitted in-plane blur (standard deviation)."""
        return float(self.theta[BLUR])

    @property
    def contrast_hu(self) -> float:
        """Ball above background."""
        return float(self.theta[CONTRAST])

    @property
    def may_be_metal(self) -> bool:
        """Whether the ball is metal, or the scale's end hides whether it is."""
        return not self.is_shaded or (has_streaks(self.theta) and self.contrast_hu > METAL_CONTRAST_HU)

    @cached_property
    def is_clipped(self) -> bool:
        """Whether voxels that informed the fit are at the top of the scale."""
        return bool((self.neighbourhood.values_hu[self.used] >= self.ceiling_hu).any())

    @cached_property
    def center_by_radius(self) -> FloatArray:
        """How far the fit would move the center (3,) along u, v, w for each mm that the radius were held larger."""
        by_radius: FloatArray = self._by_noise[CENTER, RADIUS] / self._by_noise[RADIUS, RADIUS]
        return by_radius

    @cached_property
    def center_by_slopes_mm(self) -> FloatArray:
        """How far the fitted slope of the background keeps the center (3,) along u, v, w from being moved, mm."""
        by_slopes = self._by_noise[CENTER, SLOPES] @ inverse(self._by_noise[SLOPES, SLOPES].copy())
        moved_mm: FloatArray = by_slopes @ self.theta[SLOPES]
        return moved_mm

    @cached_property
    def _by_noise(self) -> FloatArray:
        """Covariance (P, P) of all parameters for noise of 1 HU."""
        return covariance_by(self.jacobian.take(np.flatnonzero(self.used), axis=0), self.prior)

    @cached_property
    def center_by_layer(self) -> FloatArray:
        """How far the center (3, 3) is moved, in mm, by a layer that lies aside by its whole thickness along u, v, w.

        That is what is wrapped around, or the cavity of a shell whose shading was not asked for.
        """
        layer_mm = self.prior.layer_mm
        if not self.converged or layer_mm == 0.0 or (layer_mm < 0.0 and self.is_shaded):
            return np.zeros((3, 3))
        by_place = layer_jacobian(self.neighbourhood, self.theta, layer_mm)
        moved: FloatArray = layer_mm * self.influence_mm_per_hu.T @ by_place
        return moved

    @property
    def coverage(self) -> float:
        """Share that informed the fit of the ball's directions that hold voxels, or do so near a holder's faces."""
        informed, seen = (int(np.count_nonzero(self.verdict.state >= least)) for least in (1, 0))
        of_seen = informed / max(seen, 1)
        return of_seen * (1.0 - self.neighbourhood.ending_share)

    @cached_property
    def misfit(self) -> float:
        """Root mean square residual on the surface that informed the fit, as a share of the contrast."""
        near = self.used & on_surface(*edge_depth(self.neighbourhood.offsets_mm, self.theta))
        if not near.any():
            return float("inf")
        return float(np.sqrt(np.mean(self.residuals_hu[near] ** 2)) / abs(self.contrast_hu))


def fit_at(
    around: Neighbourhood,
    theta: FloatArray,
    prior: Prior,
    verdict: Verdict,
    used: NDArray[np.bool_],
    *,
    converged: bool,
    slopes: bool = True,
    bends: bool = True,
) -> BallFit:
    """Return what a fit tells that ends at ``theta`` (P,); ``used`` (N,) marks the voxels ``around`` that informed it.

    What moves the center, and its shading, are told only of a fit that has ``converged``; ``slopes`` says whether its
    contrast may slope, ``bends`` whether skin may be curved otherwise than a head is.
    """
    if not converged:  # its tests ask for nothing else
        around, used = around.select(used), np.ones(np.count_nonzero(used), dtype=np.bool_)
    residuals, jacobian = residuals_and_jacobian(around, theta, prior.layer_mm)
    is_shaded = converged and around.ceiling_hu - theta[BACKGROUND] >= PLATEAU_SHARE * theta[CONTRAST]
    if is_shaded:
        shading = shaded(around, theta, residuals, jacobian, used, prior, slopes=slopes, bends=bends)
    else:
        moves = np.zeros_like(around.offsets_mm)
        if converged:
            informed = jacobian.take(np.flatnonzero(used), axis=0)
            moves[used] = informed @ covariance_by(informed, prior)[:, CENTER]
        shading = Shading(np.zeros(3), np.zeros(3), moves, residuals)
    return BallFit(
        neighbourhood=around,
        theta=np.append(theta[CENTER] + shading.shift_mm, theta[RADIUS:]),
        used=used,
        residuals_hu=shading.residuals_hu,
        unshaded_hu=residuals,
        jacobian=jacobian,
        influence_mm_per_hu=shading.influence_mm_per_hu,
        aside_mm=shading.aside_mm,
        is_shaded=is_shaded,
        verdict=verdict,
        converged=converged,
        prior=prior,
    )


def covariance_by(informed: FloatArray, prior: Prior) -> FloatArray:
    """Covariance (Q, Q), for noise of 1 HU, by the Jacobian (N, Q) of the voxels that informed a fit, and its prior.

    What its columns hold beyond the prior's P parameters is free to change with these.
    """
    free = np.zeros(informed.shape[1] - len(prior.weight))
    return inverse(informed.T @ informed + np.diag(np.append(prior.weight, free)))
