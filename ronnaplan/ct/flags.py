"""Why a volume is to be doubted, and what its voxels are."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Voxels = NDArray[np.int16] | NDArray[np.float32]
"""HU (slice, row, column), or a part of them."""


class VolumeFlag(StrEnum):
    """Reasons to doubt a volume; each value is the sentence shown to the user."""

    LOSSY = "the images were compressed with loss"
    UNEVEN_SPACING = "the slices are not evenly spaced"
    ROUNDED = "the slices' positions are rounded, and were taken for evenly spaced as they agree with that"
    CUT_SPACING = (
        "the pixel spacing has three decimals, and the diameter of reconstruction tells that more were left out: "
        "distances in the slices may be off by 0.05 % and more"
    )
    MISSING_SLICE = "one or more slices are missing"
    DUPLICATES_DROPPED = "identical copies of a slice were dropped"
    SAME_INSTANCE = "different images bear one SOP Instance UID, so that archives keep one of them only"
    OVERLAPPING = "the slices overlap"
    TILT_CONTRADICTS = "the gantry tilt tag contradicts the slice positions"
    SHIFTED_SIDEWAYS = "slices are shifted sideways against each other"
    SHEARED = (
        "each slice lies sideways of the one before, and no tag tells of a tilted gantry; check their positions"
    )
    UNREADABLE_FILES = "some files beside the slices could not be read"
    ONLY_USABLE = "another scan beside it cannot be used, so this one was taken; check that it is the one meant"
    NO_FRAME_OF_REFERENCE = "the file names no frame of reference"
    IMAGES_LEFT_OUT = "images of the same series that do not fit the others were left out"
    MIXED_VOLTAGE = "the tube voltage changes within the volume"
    OUT_OF_ORDER = "neighbouring slices were not taken one after another"
    DERIVED = "the images were computed from others"
    REFORMATTED = "the slices were resampled from others"
    REPEATED = "slices, rows or columns repeat others, as resampling to the nearest does; give the original series"
    VIRTUAL_VALUES = "the values are those of a material or of a virtual energy"
    NO_AIR = "no value is as low as air's, as if all were offset (by 1024?); expected air at -1000 HU"
    LOW_AIR = (
        "air is far below -1000 HU, as if an offset (of -1024?) had been added twice; expected air at -1000 HU"
    )
    SIGN = (
        "values lie far below air's -1000 HU, as if the pixels were unsigned though the header calls them signed; what "
        "is bright would then be dark here"
    )
    NO_TISSUE = (
        "no value is as high as tissue's, as if the rescale slope were wrong; expected tissue at about 0 HU"
    )
    SCALED = "air and what is in it are not 1000 apart, so the values are no HU; they were scaled to find markers"
    INVERTED = "more than half is brighter than bone, as if inverted or without its sign; expected air at -1000 HU"
