from .batch import RegistrationBatch as RegistrationBatch, register_batch as register_batch
from .diagnosis import Doubt as Doubt, LeaveOneOut as LeaveOneOut
from .diagnosis import doubted_marker as doubted_marker, leave_one_out as leave_one_out
from .drift import Drift as Drift, DriftStatus as DriftStatus
from .drift import check_drift as check_drift, drift_over_time as drift_over_time
from .flags import RegistrationFlag as RegistrationFlag
from .marker_registration import MarkerRegistration as MarkerRegistration, register_markers as register_markers
from .planned import predict_tre as predict_tre, predict_tre_map as predict_tre_map
from .radius import radius_95_mm as radius_95_mm
from .registration import Pose as Pose, Registration as Registration
from .registration import register_points as register_points
