"""Plots that can be read: nothing that is written in one runs into something else."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from ronnaplan.cohort import plots
from ronnaplan.cohort.charts import control_chart
from tests.long import few_and_others


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Axes of the plots that were made."""
    found: list[Any] = []

    def keep(figure: Any) -> bytes:
        figure.canvas.draw()
        found.extend(figure.axes)
        return b""

    monkeypatch.setattr(plots, "png", keep)
    return found


@few_and_others("scans", [8, 260], [9, 14, 15])
def test_days_below_a_chart_stand_apart(drawn: list[Any], scans: int) -> None:
    days = [f"2026-{1 + n // 28:02d}-{1 + n % 28:02d}" for n in range(scans)]
    plots.chart_plot(control_chart("A", "x", days, list(np.random.default_rng(1).standard_normal(scans))))
    boxes = [label.get_window_extent() for label in drawn[0].get_xticklabels()]
    assert len(boxes) > 3
    assert all(left.x1 < right.x0 for left, right in pairwise(boxes))


def test_errors_that_hardly_differ_have_ticks_that_say_them_whole(drawn: list[Any]) -> None:
    plots.scanners_plot({"A": [0.0141110, 0.0141111], "B": [0.0141111]})
    assert drawn[0].xaxis.get_offset_text().get_text() == ""
