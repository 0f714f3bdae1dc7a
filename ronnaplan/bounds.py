"""What no value of a patient reaches, beyond which it is damage, or another unit; and where Hounsfield's scale begins.

Nothing is imported here, so that who only reads documents loads no arrays.
"""

SMALLEST_SIGMA_MM = 1e-6
LARGEST_SIGMA_MM = 1000.0
"""A localization error (standard deviation per axis) beyond these is no error of a tracker or a scanner."""

FARTHEST_POINT_MM = 1e5
"""No scanner or tracker sees a hundred metres far: such a coordinate is damage, or not in mm."""

SMALLEST_SPREAD_MM = 1.0
LARGEST_SPREAD_MM = 20_000.0
"""Points whose extent lies outside these are no head, no tool and no tracker's field in mm (metres? micrometres?)."""

AIR_HU = -1000.0
"""Where Hounsfield's scale begins: air."""

LOWEST_HU = -1024.0
"""No tissue, and no air but for noise, measures less: lower values are padding, or corners of the picture."""

METAL_HU = 2500.0
"""Denser than any bone and enamel (2,100 HU): metal. The scale of most scanners ends at 3,071."""

LARGEST_HU = 1e6
"""No scale of a scanner reaches a million; nor do a rescale's slope and intercept."""
