"""A head's markers in CT and as a tracker sees them, in another order."""

import numpy as np
from scipy.spatial.transform import Rotation

from ronnaplan.geometry import Frame, Points

CT = Frame("CT", "1.2.826.0.1.3680043.8.498.1")
OTS = Frame("OTS")
HEAD = np.array([[-60.0, 20, 40], [55, 30, 50], [5, -85, 60], [-20, 60, 75], [30, -10, 95]])
TURN = Rotation.from_rotvec([0.4, -1.2, 0.7]).as_matrix()
SHIFT = np.array([120.0, -60, -1500])
OTS_FROM_CT = np.block([[TURN, SHIFT[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


def ct_points(sd_mm: float = 0.01) -> Points:
    covariances = np.tile(sd_mm**2 * np.eye(3), (len(HEAD), 1, 1))
    return Points(HEAD.copy(), covariances, ("F1", "F2", "F3", "F4", "F5"), CT)


def readings(seed: int = 0, sd_mm: float = 0.1, order: tuple[int, ...] = (3, 0, 4, 2, 1)) -> Points:
    """Readings 1, 2, ... of the markers in ``order``."""
    noise = np.random.default_rng(seed).normal(size=HEAD.shape) * sd_mm
    seen = (HEAD @ TURN.T + SHIFT + noise)[list(order)]
    covariances = np.tile(0.17**2 * np.eye(3), (len(seen), 1, 1))
    return Points(seen, covariances, tuple(str(k + 1) for k in range(len(seen))), OTS)
