"""What a slice sees of a ball, looked up for a few discs, is what exact discs show all through its thickness."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chndtr, i0e, i1e

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.ball import discs
from ronnaplan.localization.fit.model import evaluate
from ronnaplan.localization.fit.parameters import BLUR, CONTRAST, EDGE, PARAMETERS, RADIUS, SHAPE, WIDTH
from ronnaplan.localization.fit.pile import slice_profile
from tests.long import few_and_others

SAME_SHARE = 2e-4
"""Of the contrast, away from the poles: straight lines between the places of `disc_table` are off by half of it."""

PLACES = 400
"""So many places on the profile's support tell what a box sees, by the midpoint rule."""


def seen_exactly(r: FloatArray, w: float, theta: FloatArray) -> FloatArray:
    """Share (N,) of a ball that a slice ``w`` mm above its center sees ``r`` (N,) mm beside its axis, of a box."""
    half, _, _ = slice_profile(theta[WIDTH], 0.0)
    places = w + half * (2.0 * (np.arange(PLACES) + 0.5) / PLACES - 1.0)
    a = np.sqrt(theta[RADIUS] ** 2 - places**2)[:, np.newaxis] / theta[BLUR]
    r = r / theta[BLUR]
    density = np.exp(-0.5 * (a - r) ** 2)
    along = a**2 * density * i0e(a * r) - r * a * density * i1e(a * r)
    seen: FloatArray = (chndtr(a**2, 2, r**2) + theta[EDGE] * along).mean(axis=0)
    return seen


@few_and_others("edge", [0.6], [-0.3, 0.0])
@few_and_others(("radius", "blur", "width"), [(5.75, 0.25, 1.0), (1.5, 0.4, 0.3)], [(5.75, 0.5, 0.6)])
def test_a_slice_sees_what_its_discs_show_wherever_a_voxel_lies(
    radius: float, blur: float, width: float, edge: float
) -> None:
    theta = np.zeros(len(PARAMETERS))
    theta[[RADIUS, BLUR, EDGE, WIDTH, SHAPE, CONTRAST]] = radius, blur, edge, width, 0.0, 1.0
    for w in (0.1 * radius, 0.4 * radius):
        r = np.linspace(0.0, radius + 4.0 * blur, 331)
        offsets = np.column_stack([0.6 * r, -0.8 * r, np.full(len(r), w)])
        values, _ = evaluate(offsets, theta, 0.0, *discs(theta))
        assert np.abs(values - seen_exactly(r, w, theta)).max() < SAME_SHARE


@pytest.mark.parametrize(("edge", "off"), [(-0.4, 1e-4), (0.3, 1e-4), (1.0, 4e-4), (5.0, 2e-3)])
@pytest.mark.parametrize("w", [0.3, 3.0, 5.6])
def test_a_voxel_sees_the_same_among_many_of_its_slice_as_alone(w: float, edge: float, off: float) -> None:
    theta = np.zeros(len(PARAMETERS))
    theta[[RADIUS, BLUR, EDGE, WIDTH, SHAPE, CONTRAST]] = 5.75, 0.5, edge, 1.0, 0.7, 1.0
    u, v = (some.ravel() for some in np.meshgrid(np.arange(-9.0, 9.0, 0.45), np.arange(-9.0, 9.0, 0.47)))
    many = np.column_stack([u, v, np.full(u.shape, w)])
    together, by_all = evaluate(many, theta, 0.0, *discs(theta))
    alone, by_each = (np.concatenate(some) for some in zip(*_each(many, theta), strict=True))
    assert np.abs(together - alone).max() < off
    assert (np.abs(by_all - by_each) < off + 2e-3 * np.abs(by_each).max(axis=0)).all()


def _each(many: FloatArray, theta: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    return [evaluate(one[np.newaxis], theta, 0.0, *discs(theta)) for one in many]
