"""The error of a pose, at every voxel of a scan."""

from __future__ import annotations

import numpy as np

from ronnaplan.ct.volume import CTVolume, ScalarMap
from ronnaplan.errors import check_type
from ronnaplan.geometry import Frame
from ronnaplan.pose import Pose


def error_map(pose: Pose, volume: CTVolume, frame: Frame | None = None) -> ScalarMap:
    """Return the root-mean-square error (mm) that ``pose`` brings to every voxel of a scan, which is in ``frame``.

    With the mapped place p and the pose's covariance [[R, X], [X^T, T]] its square is the quadratic
    tr T - 2 p . x + p^T (tr(R) I - R) p, where x_k = sum e_kij X_ij. Raises `FrameMismatchError` for the scan of
    another frame.
    """
    check_type(volume, CTVolume, "the volume", "a TRE map needs the scan that it is drawn over")
    if frame is not None:
        frame.require(volume.frame)
    turning, mixed, shifting = pose.covariance[:3, :3], pose.covariance[:3, 3:], pose.covariance[3:, 3:]
    quadratic = np.trace(turning) * np.eye(3) - turning
    linear = np.array([mixed[1, 2] - mixed[2, 1], mixed[2, 0] - mixed[0, 2], mixed[0, 1] - mixed[1, 0]])
    values = np.empty(volume.values.shape, dtype=np.float32)
    j, i = np.indices(values.shape[1:])
    for k, plane in enumerate(values):
        kji = np.stack([np.full(j.shape, k), j, i], axis=-1).astype(np.float64)
        places = pose.apply(volume.grid.positions_mm(kji).reshape(-1, 3))
        squared = np.trace(shifting) - 2.0 * places @ linear + np.einsum("ni,ij,nj->n", places, quadratic, places)
        plane[...] = np.sqrt(np.maximum(squared, 0.0)).reshape(plane.shape)
    return ScalarMap(values, volume.grid, "expected TRE", "mm", volume.frame)
