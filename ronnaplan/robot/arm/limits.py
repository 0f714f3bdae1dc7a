"""How far a posture is from the limits of its joints; compiled. `quality.joint_margins_deg` tells it of each joint."""

from __future__ import annotations

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def tightest(limits: FloatArray, angles: FloatArray) -> tuple[float, int]:
    """Return how far (rad) ``angles`` (N,) are from the nearest of all ``limits`` (N, 2), and which joint's that is.

    Negative beyond it.
    """
    least, joint = np.inf, 0
    for j in range(len(angles)):
        here = min(angles[j] - limits[j, 0], limits[j, 1] - angles[j])
        if here < least:
            least, joint = here, j
    return least, joint
