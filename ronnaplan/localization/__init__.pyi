from .build import Build as Build
from .fiducials import (
    Fiducial as Fiducial,
    FiducialFlag as FiducialFlag,
    Fiducials as Fiducials,
    Rejected as Rejected,
    Resolution as Resolution,
)
from .localizer import check_request as check_request, localize as localize, require_count as require_count
from .size import Size as Size, common_diameter as common_diameter, proposal as proposal, sizes_seen as sizes_seen
from .template import Template as Template
