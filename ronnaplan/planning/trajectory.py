"""A planned straight path and the instrument that follows it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray, Frame, as_numbers, as_point
from ronnaplan.pipes import Sendable
from ronnaplan.planning.electrodes import Electrode
from ronnaplan.text import LONGEST_LISTED, place, printable

SHORTEST_PATH_MM = 1.0
"""Entry and target nearer than this are the same point, or a slip."""

REMEDY = "write Trajectory('left', entry_mm, target_mm, volume.frame), INSTRUMENTS has the known instruments"

COLOUR = re.compile(r"#[0-9a-f]{6}")


COLOURS = ("#2dd4a7", "#f0e442", "#f28ac8", "#7c9cff", "#e6edf3")
"""A plan gives them to its trajectories in turn: told apart by colour-blind eyes, none of them the markers' or the
crosshair's."""


def next_colour(number: int) -> str:
    """Return the colour of a plan's trajectory after ``number`` others."""
    return COLOURS[number % len(COLOURS)]


@dataclass(frozen=True)
class Instrument:
    """What goes along a path: outer diameter and usable length, in mm."""

    name: str
    diameter_mm: float
    length_mm: float

    def __post_init__(self) -> None:
        for what, value in (("diameter", self.diameter_mm), ("length", self.length_mm)):
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"instrument {self.name} has a {what} of {value} mm; expected a positive length")

    @property
    def radius_mm(self) -> float:
        """Half the diameter."""
        return self.diameter_mm / 2


INSTRUMENTS = {
    instrument.name: instrument
    for instrument in (
        Instrument("pointer", 1.0, 200.0),
        Instrument("biopsy needle", 1.8, 250.0),
        Instrument("SEEG electrode", 0.8, 150.0),
        Instrument("DBS lead", 1.27, 280.0),
        Instrument("guide cannula", 2.1, 220.0),
        Instrument("twist drill", 2.4, 180.0),
        Instrument("endoscope", 6.0, 180.0),
    )
}
"""Typical sizes, by name. Any other instrument is stated with its diameter and length."""


def instrument_named(name: str) -> Instrument:
    """Return the catalogue's instrument; raises `InputError` with the known names."""
    try:
        return INSTRUMENTS[name]
    except KeyError:
        raise InputError(
            f"unknown instrument {name!r}; expected one of {', '.join(INSTRUMENTS)}, or state diameter and length"
        ) from None


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Sendable):
    """A straight path from ``entry_mm`` (3,), at the scalp, to ``target_mm`` (3,), LPS mm in ``frame``.

    ``instrument`` goes along it; ``electrode`` is what stays there, its tip at the target. Without a ``colour``
    it gets that of its place in the plan that it is added to.

    Raises `InputError` for points that are not finite or nearer than `SHORTEST_PATH_MM`, an empty name, or a
    colour that is not ``#rrggbb``.
    """

    name: str
    entry_mm: FloatArray
    target_mm: FloatArray
    frame: Frame = field(default_factory=lambda: Frame("CT"))
    instrument: Instrument = INSTRUMENTS["pointer"]
    colour: str = ""
    locked: bool = False
    notes: str = ""
    electrode: Electrode | None = None

    def __post_init__(self) -> None:
        for value, kind, what in (
            (self.name, str, "a trajectory's name"),
            (self.frame, Frame, "a trajectory's frame"),
            (self.instrument, Instrument, "a trajectory's instrument"),
            (self.colour, str, "a trajectory's colour"),
            *([(self.electrode, Electrode, "a trajectory's electrode")] if self.electrode is not None else []),
        ):
            check_type(value, kind, what, REMEDY)
        if not self.name.strip():
            raise InputError("a trajectory has no name; give it one")
        for end, value in (("entry", self.entry_mm), ("target", self.target_mm)):
            point = as_point(value, f"the {end} of {self.name}").copy()
            point.setflags(write=False)
            object.__setattr__(self, f"{end}_mm", point)
        if self.length_mm < SHORTEST_PATH_MM:
            raise InputError(
                f"entry and target of {self.name} are {self.length_mm:.2f} mm apart; expected two different points"
            )
        if self.colour and not COLOUR.fullmatch(self.colour):
            raise InputError(f"colour {self.colour!r} of {self.name} is not of the form #rrggbb (lower case)")

    def __repr__(self) -> str:
        name, ends = printable(self.name, LONGEST_LISTED), f"{place(self.entry_mm)} to {place(self.target_mm)} mm"
        return f"Trajectory({name}: {ends} in {self.frame.name}, {self.length_mm:.1f} mm)"

    @cached_property
    def length_mm(self) -> float:
        """Distance from entry to target."""
        return float(np.linalg.norm(self.target_mm - self.entry_mm))

    @cached_property
    def inward(self) -> FloatArray:
        """Unit vector (3,) from entry to target."""
        direction: FloatArray = (self.target_mm - self.entry_mm) / self.length_mm
        direction.setflags(write=False)
        return direction

    @property
    def contacts_mm(self) -> FloatArray:
        """Middles (N, 3) of the electrode's contacts, the deepest first; none without an electrode."""
        if self.electrode is None:
            return np.empty((0, 3))
        return self.at_depth(self.length_mm - self.electrode.from_tip_mm)

    def at_depth(self, depths_mm: ArrayLike) -> FloatArray:
        """Return the points (..., 3) at ``depths_mm`` (...) from the entry towards the target."""
        depths = as_numbers(depths_mm, "depths", "a number of mm from the entry, or several")
        places: FloatArray = self.entry_mm + depths[..., np.newaxis] * self.inward
        return places


def ends_mm(those: Sequence[Trajectory]) -> FloatArray:
    """Return entry and target (N, 2, 3) of trajectories, LPS mm."""
    return np.array([(one.entry_mm, one.target_mm) for one in those], dtype=np.float64).reshape(-1, 2, 3)
