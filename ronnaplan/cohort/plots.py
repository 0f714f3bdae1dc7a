"""The plots of a cohort's page, each a PNG."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.cohort.charts import ControlChart
from ronnaplan.report.picture import png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOR, QUIET, ALARM = "#2f6fb0", "#c8d2dc", "#b3261e"
MOST_BARS = 15
MOST_DAYS = 8
"""Days that are written below a chart: more would run into each other."""
MOST_POINTS = 20_000
"""Points of a scatter plot: of more, every so many."""


def new_figure(width: float, height: float) -> tuple[Figure, Axes]:
    """Return a figure that needs no display, with one pair of axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def found_plot(counts: Counter[tuple[int, int]]) -> bytes:
    """Plot how many markers were found where how many were expected."""
    figure, axes = new_figure(5.2, 4.2)
    expected, found = np.array(list(counts)).T
    sizes = np.array(list(counts.values()))
    top = max(expected.max(), found.max()) + 1
    axes.plot([0, top], [0, top], color=QUIET, zorder=0)
    is_right = expected == found
    area = 60 + 900 * sizes / sizes.max()
    axes.scatter(expected, found, area, color=np.where(is_right, COLOR, ALARM), alpha=0.75)
    for x, y, count in zip(expected, found, sizes, strict=True):
        axes.annotate(str(count), (x, y), ha="center", va="center", fontsize=8, color="white")
    axes.set(xlabel="markers expected", ylabel="markers found", xlim=(-0.5, top), ylim=(-0.5, top))
    axes.locator_params(integer=True)
    return png(figure)


def scanners_plot(scanners: dict[str, list[float]]) -> bytes:
    """Plot the RMS errors by scanner: median, middle half, 5 % to 95 %."""
    names = sorted(scanners, key=lambda name: -len(scanners[name]))[:MOST_BARS]
    figure, axes = new_figure(7.5, 1.4 + 0.4 * len(names))
    values = [1e3 * np.array(scanners[name]) for name in names]
    axes.boxplot(
        values,
        orientation="horizontal",
        whis=(5, 95),
        widths=0.6,
        showfliers=False,
        medianprops={"color": ALARM},
        boxprops={"color": COLOR},
        whiskerprops={"color": COLOR},
        capprops={"color": COLOR},
    )
    labels = [f"{name} ({len(scanners[name])})" for name in names]
    axes.set_yticks(range(1, len(names) + 1), labels)
    axes.invert_yaxis()
    axes.set_xlabel("RMS error stated of a scan's worst marker, um")
    axes.ticklabel_format(axis="x", useOffset=False)
    return png(figure)


def thickness_plot(pairs: list[tuple[float, float]]) -> bytes:
    """Plot the RMS error against the slice thickness."""
    figure, axes = new_figure(5.2, 4.2)
    step = 1 + len(pairs) // MOST_POINTS
    thickness_mm, error_mm = np.array(pairs[::step]).T
    axes.scatter(thickness_mm, 1e3 * error_mm, 14, color=COLOR, alpha=0.5, linewidths=0)
    axes.set(xlabel="slice thickness, mm", ylabel="RMS error stated of a scan's worst marker, um", yscale="log")
    for which in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
        which("{x:g}")
    axes.set_xlim(left=0)
    return png(figure)


def misfit_plot(misfits: list[float]) -> bytes:
    """Plot how well the model fits each scan's worst marker."""
    figure, axes = new_figure(5.2, 3.2)
    axes.hist(100 * np.array(misfits), bins=40, color=COLOR)
    axes.set(xlabel="misfit of a scan's worst marker, % of its contrast", ylabel="series")
    axes.locator_params(axis="y", integer=True)
    return png(figure)


def reasons_plot(rejected: Counter[str]) -> bytes:
    """Plot how many candidates each test rejected, most first."""
    top = rejected.most_common(MOST_BARS)
    figure, axes = new_figure(7.5, 0.9 + 0.28 * len(top))
    bars = axes.barh([name for name, _ in top], [count for _, count in top], color=COLOR)
    axes.bar_label(bars, padding=3, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("candidates")
    return png(figure)


def chart_plot(chart: ControlChart) -> bytes:
    """Draw a control chart: single values and their limits, the moving average and its own."""
    figure, axes = new_figure(9.5, 3.2)
    numbers = np.arange(len(chart.values))
    average, limits = chart.moving_average, chart.drift_limits
    out = chart.leaps | chart.drifts
    axes.fill_between(numbers, chart.center - limits, chart.center + limits, color=QUIET, alpha=0.5, linewidth=0)
    for side in (-1.0, 1.0):
        axes.axhline(chart.center + side * chart.leap_limit, color=ALARM, linewidth=0.8, linestyle="--")
    axes.axhline(chart.center, color="#4a5a6a", linewidth=0.8)
    axes.scatter(numbers, chart.values, 14, color=np.where(chart.leaps, ALARM, COLOR))
    axes.plot(numbers, average, color=COLOR, linewidth=1.2)
    axes.plot(numbers[out], average[out], "o", markersize=3, color=ALARM)
    shown = numbers[:: -(-len(numbers) // MOST_DAYS)]
    axes.set_xticks(shown, [chart.days[n] for n in shown], fontsize=8)
    axes.set_ylabel(chart.quantity, fontsize=8)
    axes.set_title(
        f"{chart.scanner}: {chart.verdict}", fontsize=9, loc="left", color=ALARM if out.any() else "black"
    )
    return png(figure)
