"""The KUKA KR 6 R900, the arm of the RONNA system.

Link lengths and limits are the maker's (400, 25, 455, 35, 420, 80 mm). Zero is the maker's too: the arm stretched out
forwards; joints 1, 4 and 6 turn clockwise seen along +z and +x. The bodies are capsules drawn generously about the
links from their lengths, not from the maker's drawings: state others where a few centimetres matter.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import Body, SerialArm
from ronnaplan.transforms import rigid

OFFSETS_MM = ((0, 0, 400), (25, 0, 0), (455, 0, 0), (0, 0, 35), (420, 0, 0), (80, 0, 0))
AXES = ((0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0))
LIMITS_DEG = ((-170, 170), (-190, 45), (-120, 156), (-185, 185), (-120, 120), (-350, 350))

FLANGE_AXES = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
"""The flange's z points out of it, along the last link's x."""

BODIES = (
    ("base", 0, (0, 0, 60), (0, 0, 300), 140),
    ("shoulder", 1, (0, 0, -60), (25, 0, 0), 130),
    ("upper arm", 2, (0, 0, 0), (455, 0, 0), 95),
    ("elbow", 3, (-40, 0, 35), (160, 0, 35), 85),
    ("forearm", 4, (200, 0, 0), (340, 0, 0), 75),
    ("wrist", 5, (-20, 0, 0), (40, 0, 0), 60),
)
"""Name, link, start and end in the link's frame, radius; mm."""


def kr6_r900() -> SerialArm:
    """Return the arm without tools."""
    offsets = np.array(OFFSETS_MM, dtype=np.float64)
    origins = rigid(np.broadcast_to(np.eye(3), (6, 3, 3)), offsets)
    flange = rigid(np.array(FLANGE_AXES), np.zeros(3))
    bodies = tuple(Body(name, link, _point(a), _point(b), float(r)) for name, link, a, b, r in BODIES)
    joints = tuple(f"A{number}" for number in range(1, 7))
    return SerialArm(
        "kr6r900", joints, origins, np.array(AXES, dtype=np.float64), np.radians(LIMITS_DEG), flange, bodies
    )


def _point(place: tuple[int, int, int]) -> FloatArray:
    return np.array(place, dtype=np.float64)
