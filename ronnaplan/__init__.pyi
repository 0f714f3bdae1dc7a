from .correspondence import Pairing as Pairing, describe_layout as describe_layout, match_points as match_points
from .ct import CTVolume as CTVolume, read_ct as read_ct
from .documents import (
    read_fiducials as read_fiducials,
    read_plan as read_plan,
    read_registration as read_registration,
)
from .documents import write_as as write_as, write_fiducials as write_fiducials, write_plan as write_plan
from .documents import write_registration as write_registration
from .localization import Fiducials as Fiducials, localize as localize
from .planning import Plan as Plan, Trajectory as Trajectory
from .registration import Registration as Registration, register_markers as register_markers
from .registration import register_points as register_points
from .tracking import find_markers as find_markers, read_recording as read_recording

__version__: str
