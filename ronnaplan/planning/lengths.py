"""What markers, templates and paths measure, and how many entries are proposed, where nothing else is said.

Nothing is imported here, so that the command line can name them in its help at once.
"""

USUAL_DIAMETER_MM = 11.5
"""The sphere that is meant where no other is named."""

BASE_MM = 8.0
"""Height of its base and post above the scalp."""

LEAST_APART_MM, LEAST_FROM_ENTRIES_MM = 30.0, 25.0
"""Markers on a head keep these distances from each other and from the entries."""

VISIBLE_DEG = 80.0
"""How far a marker may lean away from the tracker."""

TOLERANCE_MM = 2.0
"""A path's chance to stay within so much is told."""

ENTRIES = 5
"""So many are proposed for a target."""

PLATE_MM, THICKNESS_MM = (120.0, 80.0), 4.0
"""A template's plate: from side to side, from front to back, and how thick it is."""

MARKER_HEIGHT_MM = 15.0
"""From its upper surface to a marker's center."""

CLEARANCE_MM = 6.0
"""Between the surfaces of two of its markers at least."""

HOLE_MM = 2.4
"""Diameter of a screw's hole."""

PRINT_TOLERANCE_MM, SCREW_PLAY_MM = 0.2, 0.5
"""A hole is printed off its place by up to so much along each axis, and a marker off its hole's axis and height."""
