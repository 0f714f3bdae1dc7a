"""What checks of a known phantom say together, with the limits of it; and why a scan does not pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ronnaplan.registration.phantom_check import CONFIDENCE, PhantomCheck, Stretch


@dataclass(frozen=True)
class Estimate:
    """A figure with the limits of its `CONFIDENCE` interval."""

    value: float
    low: float
    high: float


def normalized_error(judged: Sequence[tuple[float, int]]) -> Estimate:
    """Mean squared normalized error of checks together: 1 where errors are as stated, above where they are larger."""
    from scipy.special import chdtri

    total, freedom = sum(square for square, _ in judged), sum(count for _, count in judged)
    high, low = chdtri(freedom, (1.0 + CONFIDENCE) / 2.0), chdtri(freedom, (1.0 - CONFIDENCE) / 2.0)
    return Estimate(total / freedom, total / float(low), total / float(high))


def share_within(counts: Sequence[tuple[int, int]]) -> Estimate:
    """Share of markers within their ellipsoids, of checks together (Clopper and Pearson 1934, Biometrika 26:404)."""
    from scipy.special import betaincinv

    inside, count = sum(one for one, _ in counts), sum(one for _, one in counts)
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(betaincinv(inside, count - inside + 1, tail)) if inside else 0.0
    high = float(betaincinv(inside + 1, count - inside, 1.0 - tail)) if inside < count else 1.0
    return Estimate(inside / count, low, high)


def reasons_against(check: PhantomCheck) -> tuple[str, ...]:
    """Why the scan does not pass, a sentence each: markers missed or false, errors beyond what is stated, stretches."""
    reasons = []
    count = len(check.registration)
    if check.missing:
        lost = f"{len(check.missing)} of {count + len(check.missing)} markers were not found"
        reasons.append(f"{lost} ({', '.join(check.missing)}); localize --report shows why")
    if check.strange:
        reasons.append(
            f"{len(check.strange)} markers were found that the phantom does not have ({', '.join(check.strange)}); "
            "add them to the truth, or keep such balls out of the scan"
        )
    error = normalized_error([check.judged])
    if error.low > 1.0:
        reasons.append(
            f"errors are {error.value**0.5:.1f} times as large as stated (at least {error.low**0.5:.1f} times); "
            "if the phantom's own places are not that exact, say so with --sigma-truth"
        )
    reasons += [_stretched(one) for one in check.worst_stretches]
    return tuple(reasons)


def _stretched(one: Stretch) -> str:
    percent = 100 * one.share
    if one.name not in _TOO:
        return _SHEARED[one.name].format(f"{percent:+.3f} %")
    more, less, where = _TOO[one.name]
    return f"the scan is {abs(percent):.3f} % too {more if percent > 0 else less} {where}"


_TOO = {
    "in_plane": ("large", "small", "within the slices; have the pixel size calibrated"),
    "along": ("long", "short", "along the table; have the table feed calibrated"),
}
_SHEARED = {
    "shear_u": "the slices slide along their rows by {} of the way along the table; check the table's direction",
    "shear_v": "the slices slide along their columns by {} of the way along the table; check the gantry tilt",
}
