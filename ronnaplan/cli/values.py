"""Checked option values: argparse names the option in the message, and the exit status is that of wrong usage."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

from ronnaplan.text import LONGEST_NUMBER, plain_number, printable, whole_number


def sigma_mm(text: str) -> float:
    """Return a standard deviation in mm."""
    from ronnaplan.bounds import LARGEST_SIGMA_MM, SMALLEST_SIGMA_MM

    value = plain_number(text)
    if value is None or not SMALLEST_SIGMA_MM <= value < LARGEST_SIGMA_MM:
        raise argparse.ArgumentTypeError(
            f"{_short(text)} is no standard deviation in mm; expected {SMALLEST_SIGMA_MM:g} to {LARGEST_SIGMA_MM:g}"
        )
    return value


def seconds(text: str) -> float:
    """Return a duration of a recording."""
    return _duration(text, may_be_zero=False)


def wait(text: str) -> float:
    """Return how long something is waited for, which may be not at all."""
    return _duration(text, may_be_zero=True)


def _duration(text: str, *, may_be_zero: bool) -> float:
    from ronnaplan.tracking.openigtlink import LONGEST_S

    value = plain_number(text)
    if value is None or not 0 <= value <= LONGEST_S or (value == 0 and not may_be_zero):
        least = ", 0 for not at all" if may_be_zero else " above zero"
        raise argparse.ArgumentTypeError(
            f"{_short(text)} is no duration; expected a number of seconds{least}, up to {LONGEST_S:g}"
        )
    return value


def number(text: str) -> float:
    """Return a number, written with digits and a point."""
    value = plain_number(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"'{_short(text)}' is no number; expected digits and a point, no comma")
    return value


def colour(text: str) -> str:
    """Return a colour, written #rrggbb."""
    from ronnaplan.planning.trajectory import COLOUR

    if not COLOUR.fullmatch(text):
        raise argparse.ArgumentTypeError(f"'{_short(text)}' is no colour; expected #rrggbb in lower case")
    return text


def held(text: str) -> tuple[str, float]:
    """Return a joint and the angle in degrees at which it is held, written JOINT=DEGREES."""
    joint, _, angle = text.rpartition("=")
    angle_deg = plain_number(angle)
    if not joint or angle_deg is None:
        raise argparse.ArgumentTypeError(
            f"'{_short(text)}' names no joint and angle; expected a joint of the arm and degrees, as joint_3=0"
        )
    return joint, angle_deg


def whole(least: int | None = None, most: int | None = None) -> Callable[[str], int]:
    """Return the check of a whole number from ``least`` to ``most``."""
    bounds = ("" if least is None else f" from {least}") + ("" if most is None else f" to {most}")

    def check(text: str) -> int:
        value = whole_number(text)
        if value is None:
            raise argparse.ArgumentTypeError(f"'{_short(text)}' is no whole number; expected one{bounds}")
        if (least is not None and value < least) or (most is not None and value > most):
            raise argparse.ArgumentTypeError(f"{value} is out of range; expected a whole number{bounds}")
        return value

    return check


def diameters(texts: Sequence[str]) -> tuple[float, ...] | None:
    """Return the diameters (mm) that all ``--diameter`` state, None for 'auto', which stands alone.

    Raises `UsageError` for other texts.
    """
    from ronnaplan.errors import UsageError

    if "auto" not in texts:
        return tuple(diameter for text in texts for diameter in _listed(text))
    if len(texts) > 1:
        raise UsageError(f"--diameter is both {' and '.join(texts)}; state the sizes, or 'auto' alone")
    return None


def _listed(text: str) -> list[float]:
    """Return the diameters of one ``--diameter``.

    A comma may be a decimal one: several diameters are told by a point in at least one of them.
    """
    from ronnaplan.errors import UsageError

    parts = [plain_number(part) for part in text.split(",")]
    found = [value for value in parts if value is not None]
    if len(found) < len(parts):
        raise UsageError(f"--diameter is '{text}'; a positive number of mm, several as 11.5,5, or 'auto'")
    if len(found) > 1 and "." not in text:
        raise UsageError(
            f"--diameter is '{text}', which may be {text.replace(',', '.', 1)} mm or {len(found)} diameters; "
            f"write a point, or for several {','.join(f'{part}.0' for part in text.split(','))}"
        )
    return found


def _short(text: str) -> str:
    return printable(text, LONGEST_NUMBER)
