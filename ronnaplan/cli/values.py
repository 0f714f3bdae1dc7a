"""Checked option values: argparse names the option in the message, and the exit status is that of wrong usage."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable


def sigma_mm(text: str) -> float:
    """Return a standard deviation in mm."""
    from ronnaplan.geometry import LARGEST_SIGMA_MM, SMALLEST_SIGMA_MM

    value = _number(text)
    if not SMALLEST_SIGMA_MM <= value < LARGEST_SIGMA_MM:
        raise argparse.ArgumentTypeError(
            f"{text} is no standard deviation in mm; expected {SMALLEST_SIGMA_MM:g} to {LARGEST_SIGMA_MM:g}"
        )
    return value


def seconds(text: str) -> float:
    """Return a duration."""
    value = _number(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is no duration; expected a number of seconds above zero")
    return value


def whole(least: int, most: int | None = None) -> Callable[[str], int]:
    """Return the check of a whole number from ``least`` to ``most``."""
    wanted = f"{least} or more" if most is None else f"{least} to {most}"

    def check(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text} is no whole number; expected {wanted}") from None
        if value < least or (most is not None and value > most):
            raise argparse.ArgumentTypeError(f"{text} is out of range; expected {wanted}")
        return value

    return check


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
