"""The kinds of field that documents are made of, each with the bounds that a value must keep.

A document is read strictly (`ronnaplan.documents.reading`): no text or truth value passes as a number, no unknown
field is passed over.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from enum import StrEnum
from typing import Annotated, Final

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    Strict,
)

from ronnaplan import __version__
from ronnaplan.bounds import FARTHEST_POINT_MM, LARGEST_HU, LARGEST_SIGMA_MM, SMALLEST_SIGMA_MM
from ronnaplan.errors import InputError, UsageError
from ronnaplan.text import LONGEST_TEXT, as_read

SYMMETRY_TOLERANCE = 1e-9
"""Largest difference of a correlation from its mirror image: round-off of a written matrix."""
LEAST_CORRELATION_EIGENVALUE = 1e-12
"""A covariance whose correlations have a smaller eigenvalue is singular: it says that something is known exactly.
Poses of a tracker 100 m away from its markers still have 1e-7."""
LONGEST_MM = 1e6
"""No length in a document reaches a kilometre."""
MOST_NATS = 1e30
"""The log evidence of points a kilometre off, with the smallest errors that can be stated, has 24 digits."""
LARGEST_RATIO = 1e6
"""No share, factor or root mean square in pixels or degrees reaches a million."""


@contextmanager
def told_by_reader() -> Iterator[None]:
    """Have the reader of a document say, with the place in it, what an `InputError` or `UsageError` says of a value."""
    try:
        yield
    except (InputError, UsageError) as error:
        raise ValueError(str(error)) from error


class DocumentModel(BaseModel):
    """A document, or a part of one: nothing is changed in it, and every field is declared."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


def flag_sentence(flags: type[StrEnum], name: str) -> str:
    """Return what the flag called ``name`` in a document says; one of another version stands for itself."""
    known = flags.__members__.get(name.upper())
    return name if known is None else known.value


def require_different_names(what: str, names: Sequence[str]) -> None:
    """Raise ValueError where two ``what`` have one name, or names that read as one."""
    seen: dict[str, str] = {}
    for name in names:
        other = seen.setdefault(as_read(name), name)
        if other != name:
            raise ValueError(f"the names '{other}' and '{name}' of two {what} read as one")
    if len(seen) != len(names):
        raise ValueError(f"two {what} have the same name")


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("holds characters that no line of text can show")
    return text


def _plain_notes(text: str) -> str:
    if any((ord(each) < 32 and each not in "\n\t") or 0x7F <= ord(each) < 0xA0 for each in text):
        raise ValueError("holds control characters")
    if any(0xD800 <= ord(each) < 0xE000 for each in text):  # as Python reads what is no text of a command line
        raise ValueError("holds characters that are no text")
    return text


def _time(value: object) -> object:
    # pydantic's own reading takes numbers, and texts of digits, for seconds since 1970
    return datetime.fromisoformat(value) if isinstance(value, str) else value


def _in_utc(time: datetime) -> datetime:
    try:
        return time.astimezone(UTC)
    except OverflowError as error:
        raise ValueError("lies before the year 1 or beyond 9999") from error


UNIT_TOLERANCE = 1e-6
"""A direction's length is 1 to within this."""

Line = Annotated[str, AfterValidator(_printable)]
"""Text for one line, without control, invisible or direction-changing characters."""
Label = Annotated[str, Field(min_length=1, max_length=LONGEST_TEXT, pattern=r"\S"), AfterValidator(_printable)]
"""A name: a line that is not blank, no longer than what is kept of a text from a file."""
EndLabel = Annotated[
    str, Field(min_length=1, max_length=LONGEST_TEXT + len(" target"), pattern=r"\S"), AfterValidator(_printable)
]
"""The name of a place: it may be a trajectory's and which end of it."""
Notes = Annotated[str, AfterValidator(_plain_notes)]
"""Text of several lines."""
Time = Annotated[AwareDatetime, Strict(), BeforeValidator(_time), AfterValidator(_in_utc)]
"""A moment, in UTC whichever zone it was written in: it is told without one."""

Coordinate = Annotated[float, Field(ge=-FARTHEST_POINT_MM, le=FARTHEST_POINT_MM)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
PositiveMm = Annotated[float, Field(gt=0, le=LONGEST_MM)]
Revision = Annotated[int, Field(ge=0)]
"""Counts the changes ever made to a document: another one after each."""
LengthMm = Annotated[float, Field(ge=0, le=LONGEST_MM)]
Hounsfield = Annotated[float, Field(ge=-LARGEST_HU, le=LARGEST_HU)]
Nats = Annotated[float, Field(ge=-MOST_NATS, le=MOST_NATS)]
Ratio = Annotated[float, Field(ge=0, le=LARGEST_RATIO)]
Probability = Annotated[float, Field(ge=0, le=1)]

Row3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Row4 = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
Row6 = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
Matrix3 = tuple[Row3, Row3, Row3]
Matrix4 = tuple[Row4, Row4, Row4, Row4]
Matrix6 = tuple[Row6, Row6, Row6, Row6, Row6, Row6]


def _definite(rows: Matrix3 | Matrix6) -> Matrix3 | Matrix6:
    import numpy as np  # loaded where there is a covariance: settings have none

    matrix = np.array(rows)
    variances = np.diag(matrix)
    if variances.min() <= 0 or variances.max() > LONGEST_MM**2:
        raise ValueError(f"is not symmetric and positive definite: it has the variances {variances.tolist()}")
    # rad^2 stand beside mm^2: compare correlations, not entries of different size
    with np.errstate(over="ignore", invalid="ignore"):
        correlation = matrix / np.sqrt(variances)[:, None] / np.sqrt(variances)[None, :]
        difference = float(np.abs(correlation - correlation.T).max())
    if not difference <= SYMMETRY_TOLERANCE:
        raise ValueError(
            f"is not symmetric and positive definite: it differs from its mirror image by {difference:g}"
        )
    least = float(np.linalg.eigvalsh(correlation)[0])
    if least < LEAST_CORRELATION_EIGENVALUE:
        raise ValueError(
            f"is not symmetric and positive definite: its correlations have the eigenvalue {least:.3g}"
        )
    return rows


def _near(rows: Matrix3) -> Matrix3:
    import numpy as np

    smallest_sd, largest_sd = np.sqrt(np.sort(np.diag(np.array(rows)))[[0, -1]]).tolist()
    if smallest_sd < SMALLEST_SIGMA_MM:
        raise ValueError(f"states an error of {smallest_sd:g} mm, below {SMALLEST_SIGMA_MM:g} mm")
    if largest_sd > LARGEST_SIGMA_MM:
        raise ValueError(f"states an error of {largest_sd:g} mm, beyond {LARGEST_SIGMA_MM:g} mm")
    return rows


def _is_unit(vector: Vector) -> Vector:
    length = math.hypot(*vector)
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f"has the length {length:.6g}; expected 1")
    return vector


Direction = Annotated[Vector, AfterValidator(_is_unit)]
"""Unit vector."""
Covariance = Annotated[Matrix3, AfterValidator(_definite)]
"""Covariance of a place, mm^2."""
MarkerCovariance = Annotated[Covariance, AfterValidator(_near)]
PoseCovariance = Annotated[Matrix6, AfterValidator(_definite)]
"""Covariance of a pose: rotation vector in rad, then translation in mm."""


class Software(DocumentModel):
    """What wrote the document."""

    name: Line
    version: Line


SOFTWARE: Final = {"name": "ronnaplan", "version": __version__}
"""What writes a document here."""
