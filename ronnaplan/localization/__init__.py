"""Every marker of a scan, its centre and how sure it is."""

from ronnaplan.localization.fiducials import Fiducial, FiducialFlag, Fiducials, Rejected
from ronnaplan.localization.localizer import check_request, localize
from ronnaplan.localization.size import common_diameter
from ronnaplan.localization.template import Template

__all__ = [
    "Fiducial",
    "FiducialFlag",
    "Fiducials",
    "Rejected",
    "Template",
    "check_request",
    "common_diameter",
    "localize",
]
