from .build import Build as Build
from .fiducials import (
    Fiducial as Fiducial,
    FiducialFlag as FiducialFlag,
    Fiducials as Fiducials,
    Rejected as Rejected,
    Resolution as Resolution,
)
from .localizer import localize as localize
from .size import Size as Size, common_diameter as common_diameter, sizes_seen as sizes_seen
from .template import Template as Template
