"""The studies' plots, in the form of the paper's Figs. 7, 8 and 9."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.studies.blocks import Record, write_whole
from ronnaplan.studies.cells import DRAWN, Cell, all_heads, calibration_of

OUTLIER_COLOURS = ("#c6dbef", "#9ecae1", "#6baed6", "#3182bd", "#08519c")
NOISE_COLOURS = {100: "#222222", 50: "#1b9e77", 200: "#d95f02", 400: "#c51b7d", DRAWN: "#7570b3"}


def new_figure(rows: int, columns: int, width: float, height: float) -> tuple[Any, Any]:
    """Return a figure that needs no display, and its axes (rows, columns)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def save(figure: Any, path: Path) -> None:
    """Write a figure as a PNG."""
    buffer = BytesIO()
    figure.savefig(buffer, dpi=130, format="png")
    write_whole(path, buffer.getvalue())


def plot_outcomes(by_cell: dict[Cell, Record], path: Path) -> None:
    """Plot unsuccessful (left) and false positive (right) answers of both algorithms: the form of Fig. 7."""
    figure, axes = new_figure(2, 2, 10, 7)
    for row, algorithm in enumerate(("published", "exact")):
        for column, (outcome, name) in enumerate(((1, "unsuccessful"), (2, "false positive"))):
            axis = axes[row, column]
            for o, colour in enumerate(OUTLIER_COLOURS):
                shares = []
                for f in range(3, 9):
                    record = all_heads(by_cell, Cell(0, f, o, expected=f))
                    shares.append(100 * record[algorithm][outcome] / sum(record[algorithm]) if record else np.nan)
                places = np.arange(3, 9) + 0.16 * (o - 2)
                axis.bar(places, shares, 0.15, color=colour, edgecolor="#444444", linewidth=0.4, label=str(o))
            axis.set_title(f"{algorithm}: {name}")
            axis.set_xlabel("number of markers f")
            axis.set_ylabel("share of tests, %")
            axis.set_yscale("symlog", linthresh=0.01)
            axis.set_ylim(0, 30)
            axis.set_yticks([0, 0.01, 0.1, 1, 10], ["0", "0.01", "0.1", "1", "10"])
            axis.grid(axis="y", color="#dddddd", linewidth=0.5)
            axis.set_axisbelow(True)
    axes[0, 0].legend(title="outliers in each set", ncols=5, fontsize="small", title_fontsize="small")
    save(figure, path)


def plot_calibration(by_cell: dict[Cell, Record], path: Path) -> None:
    """Plot the share of wrong answers against the share stated, with 95 % sampling errors."""
    figure, axes = new_figure(1, 1, 5.5, 5)
    axis = axes[0, 0]
    axis.plot([1e-6, 1], [1e-6, 1], color="#999999", linewidth=0.8)
    for noise, colour in NOISE_COLOURS.items():
        bins = np.array([row for row in calibration_of(by_cell, noise) if row[0] > 0]).reshape(-1, 3)
        wrong = bins[:, 0] - bins[:, 1]
        stated, low, high = 1 - bins[:, 2] / bins[:, 0], *poisson_limits(wrong)
        share, low, high = wrong / bins[:, 0], low / bins[:, 0], high / bins[:, 0]
        axis.errorbar(
            np.maximum(stated, 1e-6),
            np.maximum(share, 1e-6),
            yerr=np.abs(np.array([share - low, high - share])),
            fmt="o",
            markersize=4,
            capsize=2,
            color=colour,
            label="drawn from half to four times" if noise == DRAWN else f"true error {noise} % of the stated one",
        )
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlim(8e-7, 1)
    axis.set_ylim(8e-7, 1)
    axis.set_xlabel("stated probability of being wrong")
    axis.set_ylabel("share that is wrong")
    axis.legend(fontsize="small")
    axis.grid(color="#dddddd", linewidth=0.5)
    save(figure, path)


def poisson_limits(counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return exact 95 % limits of Poisson means, low and high, shaped as ``counts`` (...)."""
    from scipy.stats import chi2

    low = np.where(counts > 0, 0.5 * chi2.ppf(0.025, 2 * np.maximum(counts, 0.5)), 0.0)
    return low, np.asarray(0.5 * chi2.ppf(0.975, 2 * counts + 2))


def plot_tracking(published: FloatArray, tolerances_mm: FloatArray, kind: str, path: Path) -> None:
    """Plot the success of each scan (S, E, 3 outcomes) against e: the form of Figs. 8 and 9."""
    figure, axes = new_figure(1, 1, 7, 4)
    axis = axes[0, 0]
    share = 100.0 * published[:, :, 0] / published.sum(axis=2)
    for scan, one in enumerate(share):
        axis.plot(tolerances_mm, one, linewidth=1, label=f"scan {scan + 1}")
    axis.plot(tolerances_mm, share.min(axis=0), color="#222222", linewidth=1.8, label="worst scan")
    axis.set_xlabel("e, mm")
    axis.set_ylabel("successful correspondences, %")
    axis.set_title(f"published algorithm, {len(share)} {kind} scans x {int(published[0, 0].sum())} readings")
    axis.grid(color="#dddddd", linewidth=0.5)
    axis.legend(fontsize="x-small", ncols=2)
    save(figure, path)
