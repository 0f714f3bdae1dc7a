"""The fit of a surface: its derivatives are those of its misfit, and it ends once it is done."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from ronnaplan.ct import CTVolume
from ronnaplan.minimize import minimize
from ronnaplan.planning import patch, surface, voxels
from ronnaplan.planning.crossings import find_crossings
from ronnaplan.planning.head import Head
from ronnaplan.planning.voxels import LEAST_MM3
from tests.planning.heads import paths, scanned


def looked_at_anew(stack: str) -> Head:
    """The layered head, of which nothing is known yet."""
    return replace(scanned(stack), met=OrderedDict())


def test_the_normal_equations_are_the_derivatives_of_the_misfit() -> None:
    generator = np.random.default_rng(2)
    a, b, c = generator.uniform(-3, 3, (3, 400))
    values = generator.uniform(-900, 900, 400)
    # Level, for how the distance to the patch changes with its own tilt is of second order and left out.
    h = np.array([0.2, *np.zeros(9), 40.0, -900.0, np.log(0.6)])
    terms = patch.polynomials(a, b)

    def misfit(h: np.ndarray) -> float:
        return patch.normal_equations(terms, c, values, h, 0.8)[0]

    square, right, matrix = patch.normal_equations(terms, c, values, h, 0.8)
    slopes = np.array([(misfit(h + one) - misfit(h - one)) / 2e-5 for one in 1e-5 * np.eye(13)])
    assert -2 * right == pytest.approx(slopes, rel=1e-5, abs=1e-8 * square)
    exact = patch.normal_equations(terms, c, values * 0.0 + 40.0, np.array([-50.0, *h[1:]]), 0.8)
    assert exact[0] == pytest.approx(
        400 * 940.0**2
    )  # every voxel lies outside: 40 is found where -900 is expected
    assert matrix == pytest.approx(matrix.T)


def test_heights_and_slopes_are_those_of_a_polynomial_of_third_order() -> None:
    h = np.random.default_rng(3).standard_normal(13)
    a, b = np.array([0.3, -1.2, 2.0]), np.array([0.7, 0.4, -1.5])
    height = h[0] + h[1] * a + h[2] * b + h[3] * a**2 / 2 + h[4] * a * b + h[5] * b**2 / 2
    height += h[6] * a**3 / 6 + h[7] * a**2 * b / 2 + h[8] * a * b**2 / 2 + h[9] * b**3 / 6
    assert patch.heights(patch.polynomials(a, b), h) == pytest.approx(height)
    step = 1e-6
    by_a = (
        patch.heights(patch.polynomials(a + step, b), h) - patch.heights(patch.polynomials(a - step, b), h)
    ) / 2e-6
    by_b = (
        patch.heights(patch.polynomials(a, b + step), h) - patch.heights(patch.polynomials(a, b - step), h)
    ) / 2e-6
    slopes = patch.slopes(patch.polynomials(a, b), h)
    assert slopes[0] == pytest.approx(by_a, abs=1e-6)
    assert slopes[1] == pytest.approx(by_b, abs=1e-6)


def test_a_fit_ends_when_nothing_is_gained(monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[int] = []
    solve, equations = surface._solve, patch.normal_equations

    def counted(*arguments: Any, **options: Any) -> Any:
        counts.append(0)
        return solve(*arguments, **options)

    def counting(*arguments: Any) -> Any:
        counts[-1] += 1
        return equations(*arguments)

    monkeypatch.setattr(surface, "_solve", counted)
    monkeypatch.setattr(surface, "normal_equations", counting)
    for head in (looked_at_anew("plain"), looked_at_anew("tilted")):
        for target, outward in paths(15, seed=4):
            find_crossings(head, target, outward)
    assert len(counts) > 100
    assert sum(count > surface.MOST_STEPS / 2 for count in counts) <= 0.02 * len(counts)


def test_where_too_little_tells_how_a_surface_bends_it_is_met_without_a_fit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    target, outward = paths(1, seed=4)[0]
    fitted = find_crossings(scanned("plain"), target, outward)
    least = minimize

    def flat(*arguments: Any, **options: Any) -> Any:
        found = least(*arguments, **options)
        return replace(found, curvature=np.zeros_like(found.curvature))

    monkeypatch.setattr(surface, "minimize", flat)
    met = find_crossings(looked_at_anew("plain"), target, outward)
    assert fitted.scalp is not None
    assert met.scalp is not None
    assert fitted.scalp.clear
    assert not met.scalp.clear
    assert met.scalp.reach_mm == pytest.approx(fitted.scalp.reach_mm, abs=3.0)


def test_a_surface_in_fine_voxels_is_met_where_all_of_them_have_it_from_a_few(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Voxels of 0.25 mm: a shell of bone about water, blurred and noisy, met by a slanting ray."""
    size, radius, blur = 0.25, 40.0, 0.6
    along = size * np.arange(-60.0, 61.0)
    z, y, x = np.meshgrid(along + 25.0, along + 24.0, along + 20.0, indexing="ij")
    depth = radius - np.sqrt(x**2 + y**2 + z**2)
    noise = np.random.default_rng(7).normal(0.0, 40.0, depth.shape)
    affine = np.array([[0, 0, size, x.min()], [0, size, 0, y.min()], [size, 0, 0, z.min()], [0, 0, 0, 1.0]])
    volume = CTVolume.from_array((-1000.0 + 1040.0 * ndtr(depth / blur) + noise).round().astype(int), affine)
    outward = np.array([20.0, 24.0, 25.0]) / np.sqrt(20.0**2 + 24.0**2 + 25.0**2)
    counts: list[int] = []
    equations = patch.normal_equations

    def counting(terms: Any, c: Any, *arguments: Any) -> Any:
        counts.append(len(c))
        return equations(terms, c, *arguments)

    monkeypatch.setattr(surface, "normal_equations", counting)

    def met() -> tuple[surface.Surface, int]:
        counts.clear()
        found = surface.fit_crossing(volume, np.zeros(3), outward, radius + 0.3, limits_hu=(-1024.0, 120.0))
        return found, max(counts)

    few, fewest = met()
    monkeypatch.setattr(voxels, "LEAST_MM3", 0.0)
    whole, most = met()
    assert fewest < np.pi * surface.PATCH_RADIUS_MM**2 * 2 * surface.HALF_DEPTH_MM / LEAST_MM3 < most
    assert few.clear
    assert abs(few.reach_mm - radius) < 3 * few.sd_mm
    assert abs(few.reach_mm - whole.reach_mm) < 3 * few.sd_mm < 0.05
    assert few.normal == pytest.approx(outward, abs=2e-3)
