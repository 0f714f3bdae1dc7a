"""Control charts tell a drift and a leap, and leave steady scanners alone as often as they say."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.cohort.charts import LEAST, WEIGHT, WIDTH, ControlChart, control_chart


def chart(values: np.ndarray) -> ControlChart:
    days = [f"2026-{1 + n // 28:02d}-{1 + n % 28:02d}" for n in range(len(values))]
    return control_chart("A", "x", days, list(values))


def mean_run_length(shift: float, states: int = 201) -> float:
    """Scans until an alarm, center and scatter known, by a Markov chain (Brook and Evans 1972, Biometrika 59:539)."""
    from scipy.special import ndtr

    limit = WIDTH * np.sqrt(WEIGHT / (2 - WEIGHT))
    edges = np.linspace(-limit, limit, states + 1)
    middles = (edges[1:] + edges[:-1]) / 2
    reached = (edges[np.newaxis] - (1 - WEIGHT) * middles[:, np.newaxis]) / WEIGHT - shift
    chances = np.diff(ndtr(reached), axis=1)
    return float(np.linalg.solve(np.eye(states) - chances, np.ones(states))[states // 2])


def test_the_constants_are_those_of_the_published_chart() -> None:
    assert mean_run_length(0.0) == pytest.approx(500, rel=0.02)
    assert mean_run_length(1.0) == pytest.approx(10.3, rel=0.02)


def test_steady_years_are_rarely_flagged_and_a_step_is_found_soon() -> None:
    random = np.random.default_rng(3)
    years = 5.0 + 0.02 * random.standard_normal((300, 260))
    steady = [chart(year) for year in years]
    assert 0.10 < np.mean([one.drifts.any() for one in steady]) < 0.24
    assert 0.21 < np.mean([one.leaps.any() for one in steady]) < 0.37
    years[:, 100:] += 0.02
    late = [int(np.argmax(one.drifts[100:])) for one in map(chart, years) if one.drifts[100:].any()]
    assert len(late) > 285
    assert np.median(late) < 18


def test_days_are_put_in_order_and_too_few_scans_are_not_judged() -> None:
    days = ["2026-01-03", "2026-01-01", "2026-01-02"]
    found = control_chart("A", "x", days, [3.0, 1.0, 2.0])
    assert found.days == ("2026-01-01", "2026-01-02", "2026-01-03")
    assert found.values.tolist() == [1.0, 2.0, 3.0]
    assert "are needed" in found.verdict
    values = 0.01 * np.random.default_rng(1).standard_normal(LEAST + 40)
    values[-1] += 1.0
    assert "1 out of limits" in chart(values).verdict
    assert chart(values[:-1]).verdict == "steady"


@pytest.mark.parametrize("value", [2.0, 0.3, 1 / 3, 0.1])
def test_scans_that_never_differ_are_steady(value: float) -> None:
    assert chart(np.full(60, value)).verdict == "steady"


@pytest.mark.parametrize(("scans", "changed"), [(24, 13), (24, 20), (16, 8), (12, 6), (260, 30), (260, 8)])
def test_a_change_among_the_first_scans_is_told_of_its_day(scans: int, changed: int) -> None:
    values = 0.002 * np.random.default_rng(scans + changed).standard_normal((40, scans))
    values[:, changed:] += 0.05
    charts = [chart(one) for one in values]
    at_once = [bool(one.leaps[changed:].all()) and not one.leaps[:changed].any() for one in charts]
    assert np.mean(at_once) >= 0.9
    late = [int(np.argmax(one.drifts)) - changed for one in charts]
    assert np.mean([0 <= one <= 2 for one in late]) >= 0.9


def test_a_leap_among_the_first_scans_is_told_alone() -> None:
    for at in (0, 4, 19, 39):
        values = 0.002 * np.random.default_rng(2).standard_normal(60)
        values[at] += 0.05
        assert np.flatnonzero(chart(values).leaps).tolist() == [at]


def test_a_steady_beginning_is_hardly_ever_taken_for_changed() -> None:
    years = np.random.default_rng(5).standard_normal((1000, 40))
    assert np.mean([chart(year).baseline < 40 for year in years]) < 0.01
