"""Every marker of a scan, its centre and how sure it is."""

from ronnaplan.localization.fiducials import Fiducial, FiducialFlag, Fiducials, Rejected
from ronnaplan.localization.localizer import check_request, localize

__all__ = ["Fiducial", "FiducialFlag", "Fiducials", "Rejected", "check_request", "localize"]
