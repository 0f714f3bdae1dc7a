from .correspondence import Pairing as Pairing, describe_layout as describe_layout, match_points as match_points
from .ct import CTVolume as CTVolume, read_ct as read_ct
from .localization import Fiducials as Fiducials, localize as localize
from .planning import Plan as Plan, Trajectory as Trajectory
from .registration import Registration as Registration, register_points as register_points
from .tracking import find_markers as find_markers, read_recording as read_recording

__version__: str
