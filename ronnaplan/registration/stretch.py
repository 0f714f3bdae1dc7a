"""Whether pairs agree far better where one side is stretched: a scan, or a tracker, whose distances are wrong."""

from __future__ import annotations

from ronnaplan.geometry import FloatArray
from ronnaplan.registration.beside_a_pose import fitted_beside, moved_together
from ronnaplan.sigmas import MISFIT_PROBABILITY

STRETCH_SD = 0.03
"""Wrong pixel sizes, slice distances and scales of trackers are of some per cent: what needs more is another fault."""


def explaining_stretch(
    matrix: FloatArray, moving_mm: FloatArray, residual_mm: FloatArray, covariances_mm2: FloatArray
) -> FloatArray | None:
    """Return by which shares (3,) the moving points would have to be longer along their axes for pairs to agree.

    ``matrix`` (4, 4) is the rigid fit that left the residuals (N, 3), N four or more, of the covariances (N, 3, 3),
    both in the fixed frame. None unless chance lowers the misfit as much with a probability below `MISFIT_PROBABILITY`,
    and is no such rare explanation of what is left. Of axes along which the points hardly spread, stretches are held by
    `STRETCH_SD`.
    """
    from scipy.special import gammaincc

    stretched = matrix[:3, :3] * (moving_mm - moving_mm.mean(axis=0))[:, None, :]
    motion = moved_together(matrix, moving_mm)
    found = fitted_beside(residual_mm, covariances_mm2, motion, stretched, STRETCH_SD)
    lowered = max(found.rigid_chi_square - found.chi_square, 0.0)
    by_chance = gammaincc(len(found.unknowns) / 2, lowered / 2)
    return found.unknowns if by_chance < MISFIT_PROBABILITY <= found.probability else None
