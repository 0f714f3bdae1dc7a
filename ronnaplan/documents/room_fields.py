"""The numbers of a room: places, directions and lengths, of which such as are evidently in metres are none."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field

from ronnaplan.documents.fields import LengthMm, PositiveMm, Vector

LARGEST_STANDOFF_MM = 1000.0
"""An arm beside a patient does not come from a metre off; all of its way is looked at, every few millimetres."""
SHORTEST_DIRECTION = 1e-6
"""A direction may have any length, but none so small that it was meant to be zero."""
LARGEST_TURN_DEG = 360
"""Angles lie within a full turn, either way."""
LEAST_LENGTH_MM, LEAST_PLACE_MM = 0.1, 1.0
"""Clearances of less, and places on the flange nearer to its middle, are zero or were stated in metres."""
LOWEST_MM = 50.0
"""Neither the middle of a head nor a tracker is nearer to the floor than half its own height."""


def _above_floor(vector: Vector) -> Vector:
    if vector[2] < LOWEST_MM:
        raise ValueError(
            f"is {vector}, {vector[2]:g} mm above the floor; is it in metres? Expected {LOWEST_MM:g} or more, z up "
            "from the floor"
        )
    return vector


def _no_metres(length_mm: float) -> float:
    if 0.0 < length_mm < LEAST_LENGTH_MM:
        raise ValueError(f"is {length_mm:g} mm; is it in metres? Expected 0, or {LEAST_LENGTH_MM:g} or more")
    return length_mm


def _on_flange(vector: Vector) -> Vector:
    if 0.0 < math.hypot(*vector) < LEAST_PLACE_MM:
        raise ValueError(
            f"is {vector}, within a millimetre of the flange's middle; is it in metres? Expected that middle, or "
            f"{LEAST_PLACE_MM:g} or more from it"
        )
    return vector


def _pointing(vector: Vector) -> Vector:
    if math.hypot(*vector) < SHORTEST_DIRECTION:
        raise ValueError(f"is {vector}; expected a direction, one that points somewhere")
    return vector


def _both_ends(told: object) -> object:
    """Return least and greatest of a range, of which what does not change is told as one number."""
    if isinstance(told, int | float) and not isinstance(told, bool):
        return told, told
    if not isinstance(told, list | tuple):
        return told
    if len(told) != 2:
        raise ValueError(
            f"is a list of {len(told)}; expected the least and the greatest, or one number without brackets where it "
            "does not change"
        )
    return tuple(told)


Pointing = Annotated[Vector, AfterValidator(_pointing)]
AboveFloor = Annotated[Vector, AfterValidator(_above_floor)]
OnFlange = Annotated[Vector, AfterValidator(_on_flange)]
KeptMm = Annotated[LengthMm, AfterValidator(_no_metres)]
StandoffMm = Annotated[float, Field(ge=0, le=LARGEST_STANDOFF_MM), AfterValidator(_no_metres)]
Degrees = Annotated[float, Field(ge=-LARGEST_TURN_DEG, le=LARGEST_TURN_DEG)]
Angle = Annotated[float, Field(ge=0, le=90)]
Sides = tuple[PositiveMm, PositiveMm, PositiveMm]
Far = Annotated[float, Field(ge=-1e5, le=1e5)]
Range = Annotated[tuple[Far, Far], BeforeValidator(_both_ends, json_schema_input_type=Far | tuple[Far, Far])]
Turns = Annotated[
    tuple[Degrees, Degrees],
    BeforeValidator(_both_ends, json_schema_input_type=Degrees | tuple[Degrees, Degrees]),
]
