"""The commissures and the midline, from which stereotactic angles are told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, as_point


@dataclass(frozen=True, eq=False)
class Landmarks:
    """The commissures and any third point of the midsagittal plane (3,), LPS mm."""

    ac_mm: FloatArray
    pc_mm: FloatArray
    midline_mm: FloatArray

    def __post_init__(self) -> None:
        named = {"AC": self.ac_mm, "PC": self.pc_mm, "the midline point": self.midline_mm}
        points = np.stack([as_point(value, name) for name, value in named.items()])
        area = np.linalg.norm(np.cross(points[0] - points[1], points[2] - points[1]))
        if area < 1.0 * np.linalg.norm(points[0] - points[1]) or np.linalg.norm(points[0] - points[1]) < 1.0:
            raise InputError(
                "AC, PC and the midline point lie on one line; choose a midline point well off the AC-PC line"
            )
        points.setflags(write=False)
        for name, point in zip(("ac_mm", "pc_mm", "midline_mm"), points, strict=True):
            object.__setattr__(self, name, point)
