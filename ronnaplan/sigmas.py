"""The errors that are assumed where none are stated, and the largest that is accepted, in this one place.

Standard deviations per axis; and when residuals contradict what was stated.

Nothing is imported here, so that the command line can name them in its help at once.
"""

SIGMA_CT_MM = 0.56
"""Error of a marker's place in the scan beyond the localizer's own noise: the scanner's geometry, and skin markers
that shift between scan and surgery. The paper's patients; bone screws do far better (0.1 mm)."""

SIGMA_OTS_MM = 0.17
"""Error of one reading of a Polaris-class tracker. Averaging removes jitter but not the calibration error behind it,
so this is also the floor of a mean's standard deviation, unless the file states another."""

SIGMA_ROBOT_MM = 0.03
"""Error of an industrial arm's position per axis: the repeatability that makers of small arms state."""

SIGMA_ROBOT_DEG = 0.01
"""Error of its rotation per axis."""

SIGMA_GEOMETRY_MM = 0.05
"""Error per axis of a sphere's place on a tracked tool, as drawn or measured: a machined one."""

SIGMA_LAMP_DEG = 0.02
"""How far the middle of a lamp about a lens is from the lens, as seen from the sphere, to either side: 0.1 mm at
300 mm. The image does not show it."""

SIGMA_SQUARE = 1e-4
"""Error of the side of a calibration board's squares, as a part of it: 0.01 mm in 100 mm, as boards on glass or metal
are made to. A board that was printed or measured by a ruler is off by 0.001 and more, which no image shows."""

MISFIT_PROBABILITY = 0.001
"""Residuals that errors as stated would leave more rarely than this are called a misfit."""

LARGEST_STATED_MM = 0.012
"""A center that two cameras find with a larger stated error (RMS) is refused. Few err by 0.02 mm."""

LARGEST_TO_STATE_MM = 0.5
"""No larger limit of it can be asked for: what is known no better a tracker tells as well."""
