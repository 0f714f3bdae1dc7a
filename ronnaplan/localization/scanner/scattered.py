"""Balls whose image scatter bends so far that no fit comes to rest: what it does is given back first.

A flat panel has no septa. Behind a head it receives as much scatter as primary rays, and more, which fades the shadow
of whatever is in line with the head: by up to half, of any material, where hardened rays (`scanner.hardened`) fade
plastic by a hundredth. Back-projected, the ball has dark sides towards the head and away from it and bright ones
across, by which a fit leaves out most directions and wanders between the choices of the others. By how much the ball is
fainter, its own image tells, also about a fit that has not come to rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.cells import direction_cells
from ronnaplan.localization.fit.depth import edge_depth, within_reach
from ronnaplan.localization.fit.directions import ATTACHED_SHARE
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.parameters import CENTER
from ronnaplan.localization.fit.residuals import residuals_and_jacobian
from ronnaplan.localization.scanner.beside import all_beside
from ronnaplan.localization.scanner.hardened import (
    LEAST_LOSS,
    MadeGood,
    free_share,
    is_as_large,
    pictures_hu,
    without_the_head,
)

LEAST_ROUND = 0.3
"""A fit that has not come to rest may be a ball's if its edge is a sphere's in this share of the directions: bent balls
showed 0.35 to 0.41, capsules, half balls and clips 0.03 to 0.19."""

MOST_SCATTERED = 0.8
"""No ball is fainter by more than this where the head takes most: 0.2 to 0.75 were seen where there was 0.6 to 1.6
times as much scatter as primary rays, 1.1 and more of capsules, half balls and clips."""

ROUNDS = 3
"""So many times at most what scatter does is given back and the ball fitted anew."""


def brought_to_rest(
    volume: CTVolume, around: Neighbourhood, fit: BallFit, again: Callable[[Neighbourhood], BallFit]
) -> BallFit:
    """Return the fit of a ball with what scatter does to the voxels ``around`` given back, if that brings it to rest.

    ``again`` fits a ball anew. As it is where the fit has come to rest, voxels are no flat panel's, no ray meets much
    beside the ball, or it is no ball by what it would have lost, or by how large it comes out.
    """
    if fit.converged or not volume.grid.may_be_a_panels:
        return fit
    share, seen, now = 0.0, around, fit
    for _ in range(ROUNDS):
        if now.verdict.round_share < LEAST_ROUND:
            break
        now = replace(now, neighbourhood=seen)
        beside = all_beside(volume, now)
        if beside.losses.max() < LEAST_LOSS:
            break
        faded_hu = pictures_hu(beside, now, by_scatter=True)[0]
        share += _further_share(now, faded_hu)
        if not -MOST_SCATTERED < share < 0.0:
            break
        seen = around.given_back(-share * faded_hu)
        now = again(seen)
        if now.converged:
            return now if is_as_large(without_the_head(volume, now, MadeGood.ALL)) else fit
    return fit


def _further_share(fit: BallFit, faded_hu: FloatArray) -> float:
    """By which share a ball is brighter in line with the head, below zero, by all of its edge but what it touches."""
    around, theta = fit.neighbourhood, fit.theta
    cells = direction_cells(around.offsets_mm - theta[CENTER])
    attached = fit.verdict.excess_hu > ATTACHED_SHARE * fit.contrast_hu
    used = np.flatnonzero(within_reach(*edge_depth(around.offsets_mm, theta)) & ~attached[cells])
    rest_hu, jacobian = residuals_and_jacobian(around.take(used), theta, fit.prior.layer_mm)
    return free_share(fit, jacobian, rest_hu, faded_hu.take(used))[0]
