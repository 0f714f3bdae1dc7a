"""From DICOM (or NIfTI, NRRD, MetaImage) files to a `CTVolume` that knows where each voxel is in the patient."""

from ronnaplan.ct.catalogue import Catalogue, Series, find_series
from ronnaplan.ct.grid import SliceGrid
from ronnaplan.ct.limits import Limits
from ronnaplan.ct.reader import read_ct
from ronnaplan.ct.volume import CTVolume, SeriesSource, VolumeFlag

__all__ = [
    "CTVolume",
    "Catalogue",
    "Limits",
    "Series",
    "SeriesSource",
    "SliceGrid",
    "VolumeFlag",
    "find_series",
    "read_ct",
]
