"""Rigid registration of paired points, its residuals, and the error to expect at targets."""

from ronnaplan.pose import Pose
from ronnaplan.registration.batch import RegistrationBatch, register_batch
from ronnaplan.registration.diagnosis import Doubt, LeaveOneOut, doubted_marker, leave_one_out
from ronnaplan.registration.drift import Drift, DriftStatus, check_drift, drift_over_time
from ronnaplan.registration.marker_registration import MarkerRegistration, register_markers
from ronnaplan.registration.planned import predict_tre, predict_tre_map
from ronnaplan.registration.radius import radius_95_mm
from ronnaplan.registration.registration import Registration, RegistrationFlag, register_points

__all__ = [
    "Doubt",
    "Drift",
    "DriftStatus",
    "LeaveOneOut",
    "MarkerRegistration",
    "Pose",
    "Registration",
    "RegistrationBatch",
    "RegistrationFlag",
    "check_drift",
    "doubted_marker",
    "drift_over_time",
    "leave_one_out",
    "predict_tre",
    "predict_tre_map",
    "radius_95_mm",
    "register_batch",
    "register_markers",
    "register_points",
]
