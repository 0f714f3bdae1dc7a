"""The blurred ball equals what an independent numerical integration says of it."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.localization.fit.ball import discs
from ronnaplan.localization.fit.model import evaluate
from ronnaplan.localization.fit.parameters import (
    BACKGROUND,
    CENTER,
    CONTRAST,
    PARAMETERS,
    SKIN_PARAMETERS,
    SLOPES,
    STREAK_PARAMETERS,
)
from tests.long import few_and_others

THETA = np.array([0.1, -0.2, 0.3, 5.75, 0.5, 0.4, 1.25, 1.3, 1100.0, -1000.0, 1.0, 2.0, 3.0])
STREAKS = np.array([300.0, -200.0])
SKIN = np.array([800.0, 0.1, -0.08, 0.12])
KINDS = {
    "plain": (THETA, PARAMETERS),
    "metal": (np.append(THETA, STREAKS), (*PARAMETERS, *STREAK_PARAMETERS)),
    "on skin": (np.append(THETA, SKIN), (*PARAMETERS, *SKIN_PARAMETERS)),
    "metal on skin": (np.concatenate([THETA, STREAKS, SKIN]), (*PARAMETERS, *STREAK_PARAMETERS, *SKIN_PARAMETERS)),
}


def model(offsets: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return evaluate(offsets, theta, 0.0, *discs(theta))


@few_and_others("shape", [0.4], [0.0, 1.0, 4.0])
@pytest.mark.parametrize(
    ("diameter", "sigma", "width"), [(11.5, 0.5, 1.25), (11.5, 0.7, 5.0), (3.0, 0.4, 0.6), (11.5, 0.5, 9.0)]
)
def test_a_voxel_is_the_share_of_its_blurred_volume_that_lies_in_the_ball(
    diameter: float, sigma: float, width: float, shape: float
) -> None:
    rng = np.random.default_rng(5)
    radius = diameter / 2
    offsets = rng.uniform(-radius - 1, radius + 1, (60, 3))
    theta = np.array([0, 0, 0, radius, sigma, 0.0, width, shape, 1.0, 0.0, 0, 0, 0])
    values, _ = model(offsets, theta)
    half = width * np.sqrt((2 * shape + 3) / 12)  # a beta distribution has half^2 / (2 shape + 3) as variance
    along = half * (2 * rng.beta(shape + 1, shape + 1, 200_000) - 1)
    cloud = np.column_stack([rng.normal(0, sigma, (200_000, 2)), along])
    squares = (cloud**2).sum(axis=1)
    shares = [(squares + 2 * cloud @ offset + offset @ offset < radius**2).mean() for offset in offsets]
    assert values == pytest.approx(np.array(shares), abs=0.006)  # 4 standard errors of the cloud


@pytest.mark.parametrize(
    ("kind", "parameter"),
    [(kind, parameter) for kind, (_, names) in KINDS.items() for parameter in range(len(names))],
    ids=[f"{kind}: {name}" for kind, (_, names) in KINDS.items() for name in names],
)
def test_derivatives_are_those_of_the_model(kind: str, parameter: int) -> None:
    offsets = np.random.default_rng(6).uniform(-7.5, 7.5, (4000, 3))
    theta, names = KINDS[kind]
    step = np.zeros(len(theta))
    step[parameter] = 0.02 if names[parameter] not in SKIN_PARAMETERS[1:] else 0.0002
    by_difference = (model(offsets, theta + step)[0] - model(offsets, theta - step)[0]) / (2 * step[parameter])
    by_formula = model(offsets, theta)[1][:, parameter]
    scale = np.abs(by_formula).max()
    assert np.sqrt(np.mean((by_difference - by_formula) ** 2)) < 0.01 * scale


def test_streaks_are_bright_along_one_line_dark_across_it_and_fade() -> None:
    theta = np.append(THETA, STREAKS)
    theta[CONTRAST], theta[SLOPES] = 0.0, 0.0
    line = np.arctan2(STREAKS[1], STREAKS[0]) / 2
    along = np.array([np.cos(line), np.sin(line), 0.0])
    across = np.array([-np.sin(line), np.cos(line), 0.0])
    places = THETA[CENTER] + np.array([8.0 * along, -8.0 * along, 8.0 * across, 24.0 * along])
    bright, opposite, dark, far = model(places, theta)[0] - theta[BACKGROUND]
    assert bright == pytest.approx(opposite)
    assert bright == pytest.approx(-dark)
    assert bright > 20 * far > 0


def test_far_inside_is_full_and_far_outside_is_empty() -> None:
    offsets = np.array([[0.1, -0.2, 0.3], [12.0, 0, 0], [0, 0, -12.0]])
    flat = THETA.copy()
    flat[SLOPES] = 0
    assert model(offsets, flat)[0] == pytest.approx([100.0, -1000.0, -1000.0], abs=0.1)  # the sum over eight discs
