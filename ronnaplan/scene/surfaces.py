"""Skin, skull and regions as smooth triangles: for the eye, nothing is measured on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.scene.field import Field
from ronnaplan.scene.shapes import Body
from ronnaplan.scene.vtk import Arrays, Workshop

MOST_TRIANGLES: Final = 120_000
"""A surface with more is thinned out: a browser without a graphics card still draws this many."""


@dataclass(frozen=True)
class Level:
    """A surface at ``value``; a ``sealed`` one has no cavities that no way leads to from outside."""

    value: float
    sealed: bool = False


SURFACES: Final = {"skin": Level(-400.0, sealed=True), "skull": Level(300.0)}
"""Levels in HU."""

REGION: Final = Level(0.5)
"""The surface of a region that is 1 inside and 0 outside."""


def surfaces(
    workshop: Workshop,
    field: Field,
    levels: Mapping[str, Level] = SURFACES,
    *,
    outside: float = LOWEST_HU,
    most_triangles: int = MOST_TRIANGLES,
) -> dict[str, Body]:
    """Return the bodies at some levels of a field, by name; one without triangles where nothing reaches its level.

    Raises `InputError` where pyvista is not installed.
    """
    return bodies(workshop.arrays("surfaces", task(field, levels, outside, most_triangles)), levels)


def task(field: Field, levels: Mapping[str, Level], outside: float, most_triangles: int) -> Arrays:
    """Return what the workshop is given to make surfaces: values (K, J, I), where they lie, and the levels."""
    return {
        "values": field.values,
        "origin_mm": field.origin_mm,
        "cell_mm": np.array(field.cell_mm),
        "outside": np.array(outside),
        "names": np.array(list(levels)),
        "levels": np.array([one.value for one in levels.values()]),
        "sealed": np.array([one.sealed for one in levels.values()]),
        "most_triangles": np.array(most_triangles),
    }


def bodies(answer: Arrays, levels: Mapping[str, Level]) -> dict[str, Body]:
    """Return the workshop's answer, vertices and normals (V, 3) and triangles (T, 3), as bodies, by name."""
    return {
        name: Body(
            answer[f"{name}/vertices"].astype(np.float32),
            answer[f"{name}/normals"].astype(np.float32),
            answer[f"{name}/triangles"].astype(np.int32),
        )
        for name in levels
    }
