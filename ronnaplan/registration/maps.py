"""The error of a pose, at every voxel of a scan."""

from __future__ import annotations

import numpy as np

from ronnaplan.ct.volume import WAYS_TO_A_VOLUME, CTVolume, ScalarMap
from ronnaplan.errors import check_type
from ronnaplan.geometry import Frame
from ronnaplan.pose import Pose


def error_map(pose: Pose, volume: CTVolume | ScalarMap, frame: Frame | None = None) -> ScalarMap:
    """Return the root-mean-square error (mm) that ``pose`` brings to every voxel of a scan, which is in ``frame``.

    With the mapped place p and the pose's covariance [[R, X], [X^T, T]] its square is the quadratic
    tr T - 2 p . x + p^T (tr(R) I - R) p, where x_k = sum e_kij X_ij. Raises `FrameMismatchError` for the scan of
    another frame.
    """
    check_type(
        volume,
        (CTVolume, ScalarMap),
        "what the TRE map lies on",
        WAYS_TO_A_VOLUME,
    )
    if frame is not None:
        frame.require(volume.frame)
    turning, mixed, shifting = pose.covariance[:3, :3], pose.covariance[:3, 3:], pose.covariance[3:, 3:]
    quadratic = np.trace(turning) * np.eye(3) - turning
    linear = np.array([mixed[1, 2] - mixed[2, 1], mixed[2, 0] - mixed[0, 2], mixed[0, 1] - mixed[1, 0]])
    values = np.empty(volume.values.shape, dtype=np.float32)
    slices, rows, columns = (np.arange(int(count), dtype=np.float64) for count in volume.values.shape)
    # a voxel's place is that of its row's first voxel plus a step along the row, so one product has the mixed terms
    steps = columns[:, np.newaxis] * (pose.rotation @ volume.grid.column_step_mm)
    along_row = np.einsum("ni,ij,nj->n", steps, quadratic, steps) - 2.0 * steps @ linear
    for k, plane in zip(slices, values, strict=True):
        kji = np.stack([np.full_like(rows, k), rows, np.zeros_like(rows)], axis=-1)
        starts = pose.apply(volume.grid.positions_mm(kji))
        down = np.einsum("ni,ij,nj->n", starts, quadratic, starts) - 2.0 * starts @ linear
        squared = np.trace(shifting) + down[:, np.newaxis] + along_row + 2.0 * starts @ quadratic @ steps.T
        plane[...] = np.sqrt(np.maximum(squared, 0.0))
    return ScalarMap(values, volume.grid, "expected TRE, RMS", "mm", volume.frame)
