"""What a plan of these tests rests on: its scan's frame, a ruler, a tool."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import Frame
from ronnaplan.planning import INSTRUMENTS, Ruler

UID = "1.2.840.7"
CT = Frame("CT", UID)
ANGLE = Ruler("=A1", np.array([[9.0, 1, 1], [1.0, 1, 1], [1.0, 5, 1]]))
POINTER = INSTRUMENTS["pointer"]
