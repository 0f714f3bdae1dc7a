from .catalogue import Catalogue, Series, find_series
from .grid import SliceGrid
from .limits import Limits
from .reader import read_ct
from .volume import CTVolume, ScalarMap, SeriesSource, VolumeFlag

__all__ = [
    "CTVolume",
    "Catalogue",
    "Limits",
    "ScalarMap",
    "Series",
    "SeriesSource",
    "SliceGrid",
    "VolumeFlag",
    "find_series",
    "read_ct",
]
