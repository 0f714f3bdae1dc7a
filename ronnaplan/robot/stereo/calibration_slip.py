"""Whether both cameras rested against each other while they saw the boards: a slip between two, or a steady drift.

Boards are in the order in which they were seen. Where the right camera may stand otherwise in the rig from some board
on, or goes off steadily, the corners' residuals get smaller; that is told where noise alone does it hardly ever, and
what they lose is much. Lenses that bend otherwise than their model are fitted beside it, as they leave residuals that
go with the place of a board, and so with the order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.errors import RefusedError
from ronnaplan.robot.stereo.calibration_fit import CAMERAS, Fit

FALSE_ALARMS = 1e-4
"""Probability, over all slips and the drift together, that one is told of cameras whose corners have noise only."""
LEFT_BY_A_SLIP = 0.8
"""A slip counts where it leaves less than this share of the residuals (RMS): lenses that bend otherwise by
0.1 pixels, seen with boards that go from one side to the other, looked like one that leaves 0.85 at least."""
MOTION = slice(CAMERAS - 6, CAMERAS)
"""Of the numbers of both cameras, those of the right one's place in the rig."""
NOTHING = 1e-12
"""Of the largest eigenvalue: less is the rig's own motion, which no corner tells."""


@dataclass(frozen=True)
class Slip:
    """How the right camera moved against the left one while boards were seen."""

    after: int | None
    """The board (from 1) after which it did; None for a steady drift."""
    turned_deg: float
    probability: float
    """At most so likely noise alone looks like this, or like another slip as much."""
    rms_px: tuple[float, float]
    """What is left of the corners (per axis) without it, and with it."""


def require_rest(fit: Fit) -> None:
    """Raise `RefusedError` where a camera moved against the other one between the boards of ``fit``."""
    slip = likeliest_slip(fit)
    if slip.probability > FALSE_ALARMS or slip.rms_px[1] > LEFT_BY_A_SLIP * slip.rms_px[0]:
        return
    when = "steadily" if slip.after is None else f"between boards {slip.after} and {slip.after + 1}"
    raise RefusedError(
        f"one camera moved against the other {when} of the {len(fit.rig_from_board)} that both see whole, by "
        f"{slip.turned_deg:.2g} degrees: the corners are off by {slip.rms_px[0]:.3f} pixels RMS, but by "
        f"{slip.rms_px[1]:.3f} if it did; fasten both cameras, and take all boards again"
    )


def likeliest_slip(fit: Fit) -> Slip:
    """Return the slip, or drift, that explains most of what is left of the boards' corners, in their order."""
    from scipy.special import betainc

    sums = fit.sums_by_board
    count = len(sums)
    shares = np.vstack([np.tri(count, count - 1, -1).T, np.linspace(0.0, 1.0, count)])
    total = sums.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(total), np.finfo(float).tiny))
    kept = total[:-1, :-1] / np.outer(scale[:-1], scale[:-1])
    values, axes = np.linalg.eigh(kept)
    is_told = values > NOTHING * values[-1]
    whitening = (axes[:, is_told] / np.sqrt(values[is_told])).T / scale[:-1]
    misfit = float(total[-1, -1] - ((whitening @ total[:-1, -1]) ** 2).sum())
    free = fit.residuals_px.size - 6 * count - int(is_told.sum())
    gains, turns = [], []
    for share in shares:
        moved = np.tensordot(share, sums[:, :, MOTION], axes=1)
        followed = whitening @ moved[:-1]
        own = np.tensordot(share**2, sums[:, MOTION, MOTION], axes=1) - followed.T @ followed
        slope = moved[-1] - followed.T @ (whitening @ total[:-1, -1])
        motion = np.linalg.lstsq(own, slope, rcond=NOTHING)[0]
        gains.append(float(slope @ motion))
        turns.append(float(np.degrees(np.linalg.norm(motion[:3]))))
    best = int(np.argmax(gains))
    left = max(misfit - gains[best], 0.0)
    chance = float(betainc((free - 6) / 2, 3.0, left / max(misfit, np.finfo(float).tiny)))
    rms = float(np.sqrt(misfit / free)), float(np.sqrt(left / (free - 6)))
    return Slip(best + 1 if best < count - 1 else None, turns[best], min(chance * len(shares), 1.0), rms)
