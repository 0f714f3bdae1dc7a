"""Values between voxels, for the eye, and to tell a wrong header: all that is measured is by the voxels themselves."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray


def sampled(voxels: NDArray[Any], indices: FloatArray, outside: float) -> NDArray[np.float32]:
    """Return ``voxels`` (K, J, I) at fractional ``indices`` (..., 3), linearly interpolated; ``outside`` beyond them.

    SciPy, which does the same, takes 10 MB of a process that looks at some cuts.
    """
    last = np.subtract(voxels.shape, 1)
    sides = []
    for axis, end in enumerate(last):
        at = np.clip(indices[..., axis], 0, end)
        low = at.astype(np.intp)
        sides.append(((low, low + 1 - at), (np.minimum(low + 1, end), at - low)))
    image = sum(a * b * c * voxels[k, j, i] for (k, a), (j, b), (i, c) in product(*sides))
    is_inside = np.all((indices >= 0) & (indices <= last), axis=-1)
    return np.where(is_inside, image, outside).astype(np.float32)
