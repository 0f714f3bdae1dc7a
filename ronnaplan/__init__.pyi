from .correspondence import Pairing as Pairing, match_points as match_points
from .ct import CTVolume as CTVolume, read_ct as read_ct
from .localization import Fiducials as Fiducials, localize as localize
from .planning import Trajectory as Trajectory
from .registration import Registration as Registration, register_points as register_points

__version__: str
