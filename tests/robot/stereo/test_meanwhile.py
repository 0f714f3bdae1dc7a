"""A head, or a robot's base, that moved while the markers were looked at one after the other."""

import numpy as np
import pytest

from ronnaplan.errors import RefusedError
from ronnaplan.robot.stereo.markers import register_robot_markers
from tests.robot.stereo.test_markers import looked

COMMON = np.diag(np.repeat([1e-8, 1e-4], 3))
SHIFT_MM = np.array([1.2, -0.9, 0.0])


def register(share: list[float], sigma_ct_mm: float = 0.05) -> None:
    """Register a session of which each look had a ``share`` of a shift."""
    ct, spheres = looked(np.random.default_rng(1), 0.1, 0.03, COMMON)
    spheres.robot_from_tcp[:, :3, 3] += np.outer(share, SHIFT_MM)
    register_robot_markers(ct, spheres, sigma_ct_mm=sigma_ct_mm)


@pytest.mark.parametrize(
    ("share", "when"),
    [
        ([0, 0, 1, 1, 1], "between frames 1 and 2"),
        ([0, 0, 0, 1, 1], "between frames 2 and 3"),
        ([0, 0.25, 0.5, 0.75, 1], "steadily from frame 0 to frame 4"),
    ],
)
def test_a_head_that_moved_between_looks_is_refused_and_told_when(share: list[float], when: str) -> None:
    """A mean of both was given, half the movement off, and stated as a tenth of that."""
    with pytest.raises(
        RefusedError, match=rf"only if head or robot base moved {when} by 1\.[45]\d mm: fasten both"
    ):
        register(share)


@pytest.mark.parametrize(
    ("share", "sigma_ct_mm"),
    [([0, 0, 0, 0, 0], 0.05), ([0, 0, 1, 0, 0], 0.05), ([0.4, 0, 0, 0, 0], 0.05), ([0, 0, 1, 1, 1], 0.56)],
)
def test_neither_one_loose_marker_nor_what_errors_explain_is_a_movement(
    share: list[float], sigma_ct_mm: float
) -> None:
    register(share, sigma_ct_mm)
