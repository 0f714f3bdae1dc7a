"""A patient who moves while being scanned: everything in the scene moves as one rigid body. LPS mm.

Time is a fraction of the scan, 0 to 1. A scene describes how things lie at its start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from phantoms.cone_rays import Views
from phantoms.errors import PhantomError
from phantoms.solids import FloatArray

Form = Literal["jump", "drift", "breathing"]
FORMS: tuple[Form, ...] = ("jump", "drift", "breathing")
NECK_MM = (0.0, 20.0, -90.0)
"""About what a head turns."""


@dataclass(frozen=True)
class Motion:
    """A shift, and a turn about ``pivot_mm``, that come at once, steadily, or to and fro."""

    form: Form = "drift"
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Axis of the turn, as long as its angle in degrees."""
    when: float = 0.5
    """When a jump happens."""
    cycles: float = 5.0
    """Breaths during the scan."""
    pivot_mm: tuple[float, float, float] = NECK_MM

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise PhantomError(f"unknown form of motion {self.form!r}; expected one of {', '.join(FORMS)}")
        if not np.isfinite([*self.shift_mm, *self.turn_deg, *self.pivot_mm, self.when, self.cycles]).all():
            raise PhantomError(
                "a motion has a number that is not finite; expected finite lengths, angles and times"
            )

    @property
    def moves(self) -> bool:
        """Whether anything moves at all."""
        return any(self.shift_mm) or any(self.turn_deg)

    def amount(self, times: FloatArray) -> FloatArray:
        """Return which part of shift and turn has happened at each time (N,)."""
        if self.form == "jump":
            return (times >= self.when).astype(np.float64)
        if self.form == "drift":
            return times
        return (1 - np.cos(2 * np.pi * self.cycles * times)) / 2

    def poses(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations (N, 3, 3) and shifts (N, 3) that take a place at the start to where it is at each time."""
        amount = self.amount(np.asarray(times, dtype=np.float64))[:, np.newaxis]
        turns = Rotation.from_rotvec(amount * np.radians(self.turn_deg)).as_matrix()
        pivot = np.array(self.pivot_mm)
        return turns, pivot - turns @ pivot + amount * np.array(self.shift_mm)

    def path(self, place_mm: FloatArray, times: FloatArray) -> FloatArray:
        """Return where a place (3,) is at each time (N, 3)."""
        turns, shifts = self.poses(times)
        return turns @ place_mm + shifts

    def frames(self, places_mm: FloatArray, axes: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return places (R, V, 3) and axes (R, V, 3, 3) as the moving scene sees them at ``times`` (R, V).

        The rows of ``axes`` (3, 3) are directions that stand still.
        """
        if not self.moves:
            return places_mm, np.tile(axes, (*times.shape, 1, 1))
        turns, shifts = self.poses(times.ravel())
        moved = np.einsum("nji,nj->ni", turns, places_mm.reshape(-1, 3) - shifts)
        turned = np.einsum("nji,aj->nai", turns, axes)
        return moved.reshape(places_mm.shape), np.ascontiguousarray(turned).reshape(*times.shape, 3, 3)

    def seen(self, views: Views, times: FloatArray) -> Views:
        """Return the views (V) as they are from the moving scene: source and panel move the other way."""
        turns, shifts = self.poses(times)

        def places(points: FloatArray) -> FloatArray:
            return np.asarray(np.einsum("nji,nj->ni", turns, points - shifts))

        def directions(vectors: FloatArray) -> FloatArray:
            return np.asarray(np.einsum("nji,nj->ni", turns, vectors))

        return Views(places(views.sources), places(views.middles), directions(views.across), directions(views.up))


STILL = Motion()
"""Nothing moves."""


def random_motion(generator: np.random.Generator) -> Motion:
    """Draw a motion: a shift of 0.2 to 1 mm in any direction and a turn of up to half a degree."""
    way = generator.standard_normal(3)
    shift = generator.uniform(0.2, 1.0) * way / np.linalg.norm(way)
    axis = generator.standard_normal(3)
    turn = generator.uniform(0.0, 0.5) * axis / np.linalg.norm(axis)
    return Motion(
        FORMS[generator.integers(len(FORMS))],
        (float(shift[0]), float(shift[1]), float(shift[2])),
        (float(turn[0]), float(turn[1]), float(turn[2])),
        float(generator.uniform(0.2, 0.8)),
        float(generator.uniform(2, 8)),
    )


Span = tuple[float, float]
"""From when to when something is in the beam."""
PATH_TIMES = 41
"""Places that tell a path."""


def mean_place(motion: Motion, place_mm: FloatArray, span: Span) -> FloatArray:
    """Return where a place (3,) is on average during ``span``."""
    times = np.linspace(*span, 1001) if motion.moves else np.zeros(1)
    return np.asarray(motion.path(place_mm, times).mean(axis=0))


def timed_path(motion: Motion, place_mm: FloatArray, span: Span) -> FloatArray | None:
    """Return time and place (N, 4) during ``span``; None when nothing moves."""
    if not motion.moves:
        return None
    times = np.linspace(*span, PATH_TIMES)
    return np.column_stack([times, motion.path(place_mm, times)])
