"""Frames, point sets and named tolerances shared by every room.

World coordinates are DICOM patient coordinates (LPS) in millimetres, float64; point arrays are (N, 3).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.bounds import FARTHEST_POINT_MM, LARGEST_SIGMA_MM
from ronnaplan.errors import FrameMismatchError, InputError, check_type
from ronnaplan.text import printable

FloatArray = NDArray[np.float64]

NO_NUMBERS = "bSUmM"
"""Kinds of arrays that NumPy would turn into numbers: truth values, texts (such as `1_0`, too), times."""

SYMMETRY_TOLERANCE = 1e-6
"""Largest asymmetry of a covariance, and largest variance below zero, relative to its largest entry."""

SD_PER_DEVIATION = 1.4826
"""Standard deviation of normal errors, as a multiple of the median of their absolute deviations."""

LPS_FROM_RAS = np.array([-1.0, -1.0, 1.0])
"""RAS and LPS differ in the sign of the first two axes, either way."""

MIRROR = np.array([-1.0, 1.0, 1.0])
"""Turns points into their mirror image."""

LONGEST_LABELS = 100
"""Characters of points' labels in the line that names the points."""


@dataclass(frozen=True)
class Frame:
    """A coordinate system: its role (``CT``, ``OTS``, ``M``, ``TCP``, ``R``) and, for CT, the DICOM UID.

    Two frames are the same only when both name and UID agree. A missing UID agrees with a missing one of the same name:
    of scans without UID (NIfTI, arrays) the frames cannot tell one patient from another.
    """

    name: str
    uid: str | None = None

    def require(self, other: Frame) -> None:
        """Raise `FrameMismatchError` unless ``other`` is this very frame."""
        if self != other:
            raise FrameMismatchError(
                f"coordinates in frame {other} were offered where frame {self} is needed; "
                "register the two frames first or use data of one examination"
            )

    def __str__(self) -> str:
        return f"{self.name} [{self.uid}]" if self.uid else self.name


@dataclass(frozen=True)
class Points:
    """Labelled points of one frame: ``positions_mm`` (N, 3) with ``covariances_mm2`` (N, 3, 3).

    Holds copies. Raises `InputError` for what `as_points` refuses, and for covariances that are none.
    """

    positions_mm: FloatArray
    covariances_mm2: FloatArray
    labels: tuple[str, ...]
    frame: Frame = field(default_factory=lambda: Frame("CT"))

    def __post_init__(self) -> None:
        check_type(self.frame, Frame, "the points' frame", "give Frame(...), such as Frame('CT')")
        check_type(self.labels, Iterable, "the points' labels", "give a name for each point")
        object.__setattr__(self, "labels", tuple(map(str, self.labels)))
        positions = as_points(self.positions_mm)
        count = len(positions)
        covariances = as_numbers(self.covariances_mm2, "covariances of points", f"({count}, 3, 3) in mm^2")
        if covariances.shape != (count, 3, 3) or len(self.labels) != count:
            raise InputError(
                f"{count} points came with covariances of shape {covariances.shape} and "
                f"{len(self.labels)} labels; expected ({count}, 3, 3) and {count}"
            )
        require_covariances(covariances, "covariances of points")
        object.__setattr__(self, "positions_mm", positions.copy())
        object.__setattr__(self, "covariances_mm2", covariances.copy())

    @classmethod
    def exact(cls, positions_mm: ArrayLike, labels: tuple[str, ...], frame: Frame) -> Points:
        """Return points (N, 3) that are taken as known without error, such as those of a plan."""
        positions = as_points(positions_mm)
        return cls(positions, np.zeros((len(positions), 3, 3)), labels, frame)

    def __len__(self) -> int:
        return len(self.positions_mm)

    def __repr__(self) -> str:
        return f"Points({len(self)} in {self.frame}: {printable(', '.join(self.labels), LONGEST_LABELS)})"


def as_numbers(values: ArrayLike, name: str, expected: str) -> FloatArray:
    """Return ``values`` (...) as float64; raises `InputError` unless they are real numbers and none is masked."""
    if np.ma.is_masked(values):  # what is masked would count as what lies beneath
        raise InputError(f"{name} are masked in part; leave out what is, expected {expected}")
    try:
        given = np.asarray(values)
        if given.dtype.kind == "O":  # as of a table: NumPy tells of a list what its values are
            given = np.asarray(given.tolist())
        if np.iscomplexobj(given):
            raise InputError(f"{name} are complex numbers; expected {expected}")
        if given.dtype == object and given.ndim == 0:
            raise InputError(f"{name} came as {type(values).__name__}; expected {expected}")
        if given.dtype.kind in NO_NUMBERS:
            raise InputError(f"{name} are not numbers; expected {expected}")
        return given.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} are not numbers; expected {expected}") from error


def as_points(values: ArrayLike, name: str = "points") -> FloatArray:
    """Return ``values`` as a finite float64 array of shape (N, 3), in mm.

    Raises `InputError` naming the shape or the first row that is not finite or beyond `FARTHEST_POINT_MM`, and for
    arrays that are masked in part.
    """
    _require_bare(values, name)
    points = as_numbers(values, name, "(N, 3) coordinates in mm")
    if points.size == 0:
        points = points.reshape(0, 3)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{name} have shape {points.shape}; expected (N, 3) coordinates in mm")
    for row in np.flatnonzero(~(np.abs(points) <= FARTHEST_POINT_MM).all(axis=1))[:1]:
        _refuse_place(points[row], f"{name} row {row}")
    return points


def _require_bare(values: object, name: str) -> None:
    """Raise `InputError` for labelled points, and for a table that holds x, y, z in another order or among others."""
    if isinstance(values, Points):
        raise InputError(
            f"{name} came as Points; give their positions_mm (and their covariances_mm2 as covariances)"
        )
    if isinstance(getattr(values, "points", None), Points):
        raise InputError(
            f"{name} came as {type(values).__name__}; give their points.positions_mm (and their points.covariances_mm2 "
            "as covariances)"
        )
    columns = getattr(values, "columns", ())
    names = [] if callable(columns) else [str(column) for column in columns]
    axes = [name.lower().removesuffix("_mm") for name in names]
    if set("xyz") <= set(axes) and axes != list("xyz"):
        expected = [names[axes.index(axis)] for axis in "xyz"]
        told = printable(", ".join(names), LONGEST_LABELS)
        raise InputError(
            f"{name} came as a table with the columns {told}; expected those of places: table[{expected}]"
        )


def as_point(values: ArrayLike, name: str) -> FloatArray:
    """Return ``values`` as one finite float64 point (3,), in mm; raises `InputError` as `as_points` does."""
    point = as_numbers(values, name, "three coordinates in mm")
    if point.shape != (3,):
        raise InputError(f"{name} has shape {point.shape}; expected three coordinates in mm")
    if not (np.abs(point) <= FARTHEST_POINT_MM).all():
        _refuse_place(point, name)
    return point


def _refuse_place(point: FloatArray, name: str) -> NoReturn:
    if not np.isfinite(point).all():
        raise InputError(f"{name} is {point.tolist()}; expected finite coordinates in mm")
    raise InputError(
        f"{name} is {point.tolist()}, beyond {FARTHEST_POINT_MM:g} mm; convert the coordinates to millimetres"
    )


def require_covariances(covariances: FloatArray, name: str) -> None:
    """Raise `InputError` unless ``covariances`` (..., D, D) are finite, symmetric and of no variance below zero."""
    if not np.isfinite(covariances).all():
        raise InputError(f"{name} have entries that are not finite; expected a covariance")
    scale = np.abs(covariances).max(axis=(-2, -1))
    skew = np.abs(covariances - covariances.swapaxes(-1, -2)).max(axis=(-2, -1))
    negative = np.linalg.eigvalsh(covariances)[..., 0] < -SYMMETRY_TOLERANCE * scale
    bad = np.argwhere((skew > SYMMETRY_TOLERANCE * scale) | negative)
    if len(bad):
        which = f"that of point {bad[0, -1]}" if bad.size else "this"
        raise InputError(f"{name}: {which} is not symmetric and positive: {covariances[tuple(bad[0])].tolist()}")


def as_covariances(values: ArrayLike, count: int, name: str) -> FloatArray:
    """Return ``values``, the covariances of points, one for each or one for all, as (count, 3, 3); or `InputError`."""
    expected = f"(3, 3) or ({count}, 3, 3) in mm^2"
    given = as_numbers(values, name, expected)
    if given.shape not in ((3, 3), (count, 3, 3)):
        raise InputError(f"{name} have shape {given.shape}; expected {expected}")
    require_covariances(given, name)
    return np.broadcast_to(given, (count, 3, 3))


def rms_mm(covariances_mm2: FloatArray) -> FloatArray:
    """Return the root-mean-square lengths (...) of errors of these ``covariances_mm2`` (..., 3, 3), over all axes.

    >>> float(rms_mm(np.diag([1.0, 4.0, 4.0])))
    3.0
    """
    return np.asarray(np.sqrt(np.trace(covariances_mm2, axis1=-2, axis2=-1)))


def robust_spread(values: FloatArray) -> float:
    """Standard deviation of ``values`` (N,) by their median absolute deviation: a minority does not disturb it."""
    return SD_PER_DEVIATION * float(np.median(np.abs(values - np.median(values))))


def require_sigma(sigma_mm: float, name: str) -> None:
    """Raise `InputError` unless ``sigma_mm`` is a standard deviation per axis: zero or more, and in mm.

    Raises `UsageError` for what is no number.
    """
    check_type(sigma_mm, Real, name, "give one number, in mm")
    if not 0 <= sigma_mm < LARGEST_SIGMA_MM:
        raise InputError(
            f"{name} is {sigma_mm} mm; expected a standard deviation of zero or more, below {LARGEST_SIGMA_MM:g} mm"
        )


def mutual_distances(points: FloatArray) -> FloatArray:
    """Return how far points (N, 3) are from each other (N, N)."""
    apart: FloatArray = np.linalg.norm(points[:, np.newaxis] - points, axis=-1)
    return apart


def first_apart(points: FloatArray, least: FloatArray | float) -> list[int]:
    """Return which of ``points`` (N, 3), in order, lie no nearer than ``least`` to an earlier one that is kept.

    ``least`` may be of each point (N,); it is then that of the one that is kept.
    """
    leasts = np.broadcast_to(least, len(points))
    kept: list[int] = []
    for n, point in enumerate(points):
        if np.all(np.linalg.norm(points[kept] - point, axis=1) >= leasts[kept]):
            kept.append(n)
    return kept


def unit(vector: Sequence[float] | FloatArray) -> FloatArray:
    """Return ``vector`` (3,) scaled to length one; raises `InputError` for a zero vector."""
    array = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(array))
    if not np.isfinite(length) or length == 0.0:
        raise InputError(f"vector {array.tolist()} has no direction; expected a non-zero finite vector")
    return array / length


def axes_across(axis: FloatArray) -> FloatArray:
    """Return two unit vectors (2, 3) that make a right-handed frame with the unit vector ``axis`` (3,) as its third."""
    first = unit(np.cross(axis, np.eye(3)[np.abs(axis).argmin()]))
    return np.stack([first, np.cross(axis, first)])
