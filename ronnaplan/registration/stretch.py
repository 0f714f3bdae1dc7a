"""Whether pairs agree far better where one side is stretched: a scan, or a tracker, whose distances are wrong."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.transforms import point_jacobian, transform_points

STRETCH_SD = 0.03
"""Wrong pixel sizes, slice distances and scales of trackers are of some per cent: what needs more is another fault."""

POSE, AXES = 6, 3
"""The unknowns are the pose anew, and a share along each axis of the moving points."""


def explaining_stretch(
    matrix: FloatArray,
    moving_mm: FloatArray,
    residual_mm: FloatArray,
    covariances_mm2: FloatArray,
    *,
    rare: float,
) -> FloatArray | None:
    """Return by which shares (3,) the moving points would have to be longer along their axes for pairs to agree.

    ``matrix`` (4, 4) is the rigid fit that left the residuals (N, 3), N four or more, of the covariances (N, 3, 3),
    both in the fixed frame. None unless chance lowers the misfit as much with a probability below ``rare``, and is no
    such rare explanation of what is left. Stretches are fitted to first order; of axes along which the points hardly
    spread they are held by `STRETCH_SD`.
    """
    from scipy.special import gammaincc

    mapped = transform_points(matrix, moving_mm)
    stretched = matrix[:3, :3] * (moving_mm - moving_mm.mean(axis=0))[:, None, :]
    design = np.concatenate([point_jacobian(mapped - mapped.mean(axis=0)), stretched], axis=2)
    whitening = np.linalg.inv(np.linalg.cholesky(covariances_mm2))
    rows = np.vstack([(whitening @ design).reshape(-1, POSE + AXES), np.eye(POSE + AXES)[POSE:] / STRETCH_SD])
    rigid = np.append((whitening @ residual_mm[..., None]).ravel(), np.zeros(AXES))
    solution = np.linalg.lstsq(rows, rigid)[0]
    left = float(((rigid - rows @ solution) ** 2).sum())
    by_chance = gammaincc(AXES / 2, max(float((rigid**2).sum()) - left, 0.0) / 2)
    what_is_left = gammaincc((3 * len(moving_mm) - POSE - AXES) / 2, left / 2)
    return solution[POSE:] if by_chance < rare <= what_is_left else None
