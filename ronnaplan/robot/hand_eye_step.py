"""Whether tracker, base or tool moved partway through a hand-eye recording, and from which pose on.

One calibration for all is then a mean of two, which leaves to each half what it is off. So one of the two poses that
are sought is let change at each pose in turn, all to first order about the one calibration: it is a change where
little is left then, and less than by steady drifts. Of noise without a memory all is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.hand_eye_start import FINEST, rms_per_axis

FEWEST_FOR_A_STEP = 20
"""Of fewer a step, which has six unknowns, leaves little of any noise."""
SHORTEST = 5
"""So many poses lie before it, and after: of fewer each is told as far off by itself."""
LEFT_BY_A_STEP = 0.4
"""A step counts where it leaves less than this share of the angles or of the places (RMS)."""
AS_WELL = 0.1
"""A change of the other pose explains it as well where it leaves a sum of squares greater by less than this share."""
ROUNDS = 2
"""Each weighs angles and places by what the step of the one before leaves."""
UNDETERMINED = 1e-12
"""What poses before or after alone turn about one axis leaves some changes open: these take nothing."""
OF_OTS, OF_M = slice(0, 6), slice(6, 12)
"""Which of the unknowns are those of R from OTS, and of M from TCP; the others are drifts."""


class Step(NamedTuple):
    """From pose ``first`` on robot and tracker, or M and TCP, stand otherwise to each other than before."""

    first: int
    of_tool: bool | None
    """Whether M and TCP do; None where the poses do not tell, as where the arm hardly turned from there on."""

    def told(self, frames: Sequence[int]) -> str:
        """Say from which of ``frames`` (N,) on, and what may have happened."""
        if self.of_tool:
            said = "M stands otherwise on the tool than before, as if the tool or its marker slipped"
        elif self.of_tool is None:
            said = "tool, base or tracker stands otherwise than before; these poses do not tell which"
        else:
            said = "robot and tracker stand otherwise to each other than before, as if base or tracker were moved"
        return f"from frame {frames[self.first]} on {said}; fasten what is loose, and record anew"

    def among(self, rows: NDArray[np.intp]) -> Step:
        """Return it in the poses of which those that it was told of are ``rows`` (N,)."""
        return self._replace(first=int(rows[self.first]))

    def parts(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ``poses`` (N, ...) before it, and those from it on."""
        return poses[: self.first], poses[self.first :]


def step_in(error: FloatArray, design: FloatArray) -> Step | None:
    """Return the step, if there is one, in poses of which ``error`` (N, 6), in rad and mm, is left.

    ``design`` (N, 6, 27) is how it changes with R from OTS, with M from TCP, and with drifts.
    """
    count = len(error)
    if count < FEWEST_FOR_A_STEP:
        return None
    sds = np.ones(6)
    for _ in range(ROUNDS + 1):
        sds = np.maximum(sds, np.repeat(FINEST, 3))
        columns, observed = design / sds[:, None], error / sds
        constants = columns[..., : OF_M.stop]
        first, of_tool, sure = _likeliest(observed, constants)
        later = constants[..., OF_M if of_tool else OF_OTS].copy()
        later[:first] = 0
        stepped, still, drifting = (
            _left(observed, one) for one in (np.concatenate([constants, later], axis=2), constants, columns)
        )
        before, sds = sds * rms_per_axis(still), sds * rms_per_axis(stepped)
    if (sds < LEFT_BY_A_STEP * before).any() and (stepped**2).sum() < (drifting**2).sum():
        return Step(first, of_tool if sure else None)
    return None


def _likeliest(observed: FloatArray, design: FloatArray) -> tuple[int, bool, bool]:
    """Return the step that takes most from the sum of squares: its pose, whether it is M's, and whether that is sure.

    It is found by the normal equations of all poses from each on.
    """
    normal = np.cumsum(np.einsum("nci,ncj->nij", design, design)[::-1], axis=0)[::-1]
    score = np.cumsum(np.einsum("nci,nc->ni", design, observed)[::-1], axis=0)[::-1]
    all_of_it, at_all = np.linalg.inv(normal[0]), score[0]
    firsts = slice(SHORTEST, len(design) - SHORTEST + 1)
    gains = []
    for which in (OF_OTS, OF_M):
        mixed = normal[firsts, :, which]
        own = normal[firsts, which, which] - mixed.swapaxes(1, 2) @ all_of_it @ mixed
        open_ = score[firsts, which] - (all_of_it @ at_all) @ mixed
        inverse = np.linalg.pinv(own, rcond=UNDETERMINED, hermitian=True)
        gains.append(np.einsum("ka,kab,kb->k", open_, inverse, open_))
    of_tool, first = np.unravel_index(np.argmax(gains), (2, len(gains[0])))
    sure = np.ptp(np.max(gains, axis=1)) > AS_WELL * observed.size  # which is about what it leaves
    return int(first) + SHORTEST, bool(of_tool), bool(sure)


def _left(observed: FloatArray, design: FloatArray) -> FloatArray:
    """Return (N, 6): what least squares leave of ``observed``."""
    flat = design.reshape(-1, design.shape[2])
    solution = np.linalg.lstsq(flat, observed.ravel(), rcond=None)[0]
    left: FloatArray = observed - design @ solution
    return left
