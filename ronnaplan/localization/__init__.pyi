from .build import Build as Build
from .fiducials import (
    Fiducial as Fiducial,
    FiducialFlag as FiducialFlag,
    Fiducials as Fiducials,
    Rejected as Rejected,
    Resolution as Resolution,
)
from .localizer import check_request as check_request, localize as localize
from .size import common_diameter as common_diameter
from .template import Template as Template
