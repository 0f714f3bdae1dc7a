"""Quality over time: a known phantom scanned again and again on one scanner, judged by control charts.

Individual values against limits from their moving range (W. A. Shewhart, Economic Control of Quality of Manufactured
Product, 1931; D. C. Montgomery, Introduction to Statistical Quality Control, 6.4), which tell a leap; and the
exponentially weighted moving average (S. W. Roberts 1959, Technometrics 1:239), which tells a drift. Limits allow for
what the first scans leave unknown of center and scatter: in simulated years of 260 scans with nothing wrong, 17 % of
charts show a drift and 29 % a leap (59 % and 55 % with limits taken as exact); a step of one standard deviation
is found after 13 scans (`tests/cohort/test_charts.py`). Scans after a change among the first ones set no limits: they
would hide the change, or have it told of the scans before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray

BASELINE: Final = 40
"""Scans among which those are that set the limits: all of them, unless something changes there."""
LEAST: Final = 8
"""With fewer scans nothing is flagged."""
CHANGE_CHANCE: Final = 0.01
"""Chance, at most, that a change is seen among the first scans of a steady scanner."""
MEAN_RANGE: Final = 2.0 / np.sqrt(np.pi)
MEDIAN_RANGE: Final = 0.9539
"""Mean and median difference of two normal values, in standard deviations."""
WEIGHT: Final = 0.1
"""Of the newest value in the moving average."""
WIDTH: Final = 2.814
"""Half width of its limits, in its standard deviations: were these known, one false alarm in 500 scans, and a step of
one standard deviation found after 10 (J. M. Lucas and M. S. Saccucci 1990, Technometrics 32:1)."""
LEAP: Final = 3.0
"""Half width of the limits of single values: were these known, one false alarm in 370 scans."""
RANGE_EFFICIENCY: Final = 0.62
MEDIAN_EFFICIENCY: Final = 0.3
"""Degrees of freedom of a standard deviation from moving ranges, their mean and their median, as a share of those of
the usual one."""


@dataclass(frozen=True, eq=False)
class ControlChart:
    """A scanner's values (N,), in the order of the days, with the limits that their beginning sets."""

    scanner: str
    quantity: str
    days: tuple[str, ...]
    values: FloatArray
    center: float
    sigma: float
    baseline: int
    """How many scans set the limits."""

    @property
    def moving_average(self) -> FloatArray:
        """The exponentially weighted moving average (N,), begun at the center."""
        averages = np.empty_like(self.values)
        last = self.center
        for n, value in enumerate(self.values):
            last = averages[n] = last + WEIGHT * (value - last)  # exact where nothing differs
        return averages

    @property
    def drift_limits(self) -> FloatArray:
        """Half width (N,) of the moving average's limits, which widen over the first scans."""
        left = (1.0 - WEIGHT) ** np.arange(1, len(self.values) + 1)
        share = WEIGHT / (2.0 - WEIGHT) * (1.0 - left**2) + (1.0 - left) ** 2 / self.baseline
        limits: FloatArray = self._widened(WIDTH) * self.sigma * np.sqrt(share)
        return limits

    @property
    def leap_limit(self) -> float:
        """Half width of the single values' limits."""
        return float(self._widened(LEAP) * self.sigma * np.sqrt(1.0 + 1.0 / self.baseline))

    @property
    def leaps(self) -> NDArray[np.bool_]:
        """Which single values (N,) are out of their limits."""
        return self._judged(np.abs(self.values - self.center) > self.leap_limit)

    @property
    def drifts(self) -> NDArray[np.bool_]:
        """At which scans (N,) the moving average is out of its limits."""
        return self._judged(np.abs(self.moving_average - self.center) > self.drift_limits)

    def _widened(self, width: float) -> float:
        """Return the width, in standard deviations that are estimated, with the same chance of a false alarm."""
        from scipy.special import ndtr, stdtrit

        freedom = RANGE_EFFICIENCY * max(self.baseline - 1, 1)
        return float(-stdtrit(freedom, float(ndtr(-width))))

    def _judged(self, is_out: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return is_out & (len(self.values) >= LEAST)

    @property
    def verdict(self) -> str:
        """What the chart says, in a clause."""
        if len(self.values) < LEAST:
            return f"{len(self.values)} scans; {LEAST} are needed to judge"
        told = []
        if self.drifts.any():
            told.append(f"drifts since {self.days[int(np.argmax(self.drifts))]}")
        if self.leaps.any():
            first = self.days[int(np.argmax(self.leaps))]
            told.append(f"{int(self.leaps.sum())} out of limits, first on {first}")
        return ", ".join(told) or "steady"


def control_chart(scanner: str, quantity: str, days: Sequence[str], values: Sequence[float]) -> ControlChart:
    """Chart the values of one scanner in the order of their days; the first ones set the limits (`BASELINE`)."""
    order = np.argsort(np.array(days), kind="stable")
    sorted_values = np.asarray(values, dtype=np.float64)[order]
    base = _unchanged(sorted_values[:BASELINE])
    ranges = np.abs(np.diff(base))
    sigma = float(ranges.mean() / MEAN_RANGE) if len(ranges) else 0.0
    in_order = tuple(days[n] for n in order)
    center = float(base[0] + (base - base[0]).mean())
    return ControlChart(scanner, quantity, in_order, sorted_values, center, sigma, len(base))


def _unchanged(values: FloatArray) -> FloatArray:
    """Return what precedes the changes among ``values`` (N,), or what follows where that is too short to judge by."""
    while before := _change(values):
        is_enough = before >= LEAST or 2 * before >= len(values)
        values = values[:before] if is_enough else values[before:]
    return values


def _change(values: FloatArray) -> int:
    """Return how many of ``values`` (N,) precede the likeliest change of their mean; 0 where there is no sure one.

    The largest difference between means before and after, in its standard deviations (D. M. Hawkins 1977, J. Am. Stat.
    Assoc. 72:180), is judged at a level shared by all places. A leap hardly changes the median of the moving ranges.
    """
    from scipy.special import stdtrit

    count = len(values)
    if count < 2:
        return 0
    before = np.arange(1, count)
    sums = np.cumsum(values - values[0])
    apart = np.abs(sums[:-1] / before - (sums[-1] - sums[:-1]) / (count - before))
    scores = apart / np.sqrt(1.0 / before + 1.0 / (count - before))
    likeliest = int(np.argmax(scores))
    freedom = MEDIAN_EFFICIENCY * (count - 1)
    width = -stdtrit(freedom, CHANGE_CHANCE / 2.0 / (count - 1))
    sigma = float(np.median(np.abs(np.diff(values)))) / MEDIAN_RANGE
    return likeliest + 1 if scores[likeliest] > width * sigma else 0
