"""The error to expect of a layout of markers before anything is measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray, Frame, as_points
from ronnaplan.pose import Pose
from ronnaplan.registration.covariances import Covariances, as_pair
from ronnaplan.rigid import pose_covariance, remaining_error, require_spread

if TYPE_CHECKING:
    from ronnaplan.ct.volume import CTVolume, ScalarMap

PLANNED = Frame("planned")


def predict_tre(markers_mm: ArrayLike, covariances_mm2: Covariances, targets_mm: ArrayLike) -> FloatArray:
    """Return the TRE covariance (T, 3, 3) to expect at ``targets_mm`` (T, 3) before anything is measured.

    ``markers_mm`` (N, 3) are planned markers in the targets' frame. ``covariances_mm2`` is what each marker errs by in
    the scan plus what it errs by before the tracker, mm^2 in that frame: (N, 3, 3), or (3, 3) for all markers; of
    standard deviations ``s`` and ``t`` mm per axis it is ``(s**2 + t**2) * numpy.eye(3)``. A tuple (scan, tracker)
    tells more: where a rotation is uncertain by some degrees, the errors of both turn against each other (second
    order). `predict_tre_map` tells the error at every voxel of a scan, `radius_95_mm` how far off a
    target stays with a chance of 95 %. Raises `UsageError` without covariances, `InputError` for fewer than three
    markers, markers on one line, and covariances that are none.
    """
    return planned_pose(markers_mm, covariances_mm2).point_covariances(targets_mm)


def predict_tre_map(
    markers_mm: ArrayLike, covariances_mm2: Covariances, volume: CTVolume | ScalarMap
) -> ScalarMap:
    """Return the root-mean-square TRE (mm) to expect at every voxel of a scan before anything is measured.

    Markers, in the scan's coordinates (LPS), and their errors are those of `predict_tre`. ``to_sitk``, ``to_nibabel``
    and the like give the map to other libraries. Where there is no scan yet, any grid will do:
    ``CTVolume.from_array(numpy.zeros(shape), affine)``. Raises what `predict_tre` does.
    """
    from ronnaplan.registration.maps import error_map

    return error_map(planned_pose(markers_mm, covariances_mm2), volume)


def planned_pose(markers_mm: ArrayLike, covariances_mm2: Covariances, *, located: bool = False) -> Pose:
    """Return the pose to expect of planned markers (N, 3): no motion, with its covariance.

    ``located``: the places were found in the scan, with the scan's errors; left out, they are a plan.

    Raises `UsageError` where no covariances are stated, `InputError` for fewer than three markers or a row of them.
    """
    markers = as_points(markers_mm, "markers")
    require_spread(markers, "markers")
    stated = as_pair(covariances_mm2, (len(markers),))
    if stated is None:
        raise UsageError("no errors of the markers were stated; expected covariances (3, 3) or (N, 3, 3) in mm^2")
    scan, tracker = stated
    covariance = pose_covariance(
        markers, scan + tracker, remaining_error(scan, tracker), scan if located else None
    )
    return Pose(np.eye(4), covariance, PLANNED, PLANNED)
