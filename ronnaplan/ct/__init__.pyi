from .catalogue import Catalogue as Catalogue, Series as Series, find_series as find_series
from .grid import SliceGrid as SliceGrid
from .limits import Limits as Limits
from .reader import read_ct as read_ct
from .volume import CTVolume as CTVolume, ScalarMap as ScalarMap
from .volume import SeriesSource as SeriesSource, VolumeFlag as VolumeFlag
