"""A ball whose contrast slopes.

The side of a ball that faces the head is seen by a harder beam, so its contrast slopes. A fit without that slope and
one with it err to opposite sides and equally far (physically simulated patients, `docs/localization.md`), so the
centre is put between the two.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.descent import Prior
from ronnaplan.localization.neighbourhood import Neighbourhood

TILT_BELIEF = 0.5
"""How much of the contrast's slope that a fit would find is believed."""

PLATEAU_SHARE = 0.9
"""The contrast's slope is only asked for where the scale reaches this share of the contrast: clipped metal hides it."""


def tilted(
    around: Neighbourhood,
    theta: FloatArray,
    residuals_hu: FloatArray,
    jacobian: FloatArray,
    used: NDArray[np.bool_],
    prior: Prior,
) -> tuple[FloatArray, FloatArray]:
    """How far the centre (3,) would move if the contrast had a slope, and each voxel's influence (N, 3) then."""
    own = jacobian[used]
    tilt = own[:, 6:7] * (around.offsets_mm[used] - theta[:3])
    informed = np.hstack([own, tilt])
    inverse = np.linalg.pinv(informed.T @ informed + np.diag(np.append(prior.weight, np.zeros(3))), hermitian=True)
    # The fit without a slope is at rest, so only the slope's own columns still pull.
    shift_mm: FloatArray = inverse[:3, -3:] @ (tilt.T @ residuals_hu[used])
    moves = np.zeros((len(used), 3))
    moves[used] = informed @ inverse[:, :3]
    return shift_mm, moves
