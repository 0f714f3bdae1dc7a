"""A fit that is no ball's is given up soon, and one of a sharp kernel finds the better of its minima."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit import descent, refine
from ronnaplan.localization.fit.descent import (
    BEGIN,
    FIRST_DAMPING,
    HOPELESS_SIZE,
    LEAST_DAMPING,
    LOOK,
    REST,
    WHOLE,
    Effort,
    Prior,
    descend,
    go_on,
)
from ronnaplan.localization.fit.guess import ball_prior, first_guess
from ronnaplan.localization.fit.neighbourhood import Neighbourhood, gather
from ronnaplan.localization.fit.parameters import BLUR, CENTER, EDGE, RADIUS
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, scan, small_stack


@pytest.mark.parametrize(("hopeless", "is_pursued"), [(0.0, True), (1.01, False)])
def test_what_is_not_round_once_its_directions_were_chosen_is_not_pursued(
    hopeless: float, is_pursued: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled = []

    def counting(*given):  # type: ignore[no-untyped-def]
        settled.append(given[-1] is not LOOK)
        return descend(*given)

    def counting_on(*given):  # type: ignore[no-untyped-def]
        settled.append(True)
        return go_on(*given)

    monkeypatch.setattr(refine, "descend", counting)
    monkeypatch.setattr(refine, "go_on", counting_on)
    monkeypatch.setattr(refine, "HOPELESS_ROUND", hopeless)
    volume = scan(balls([(0.3, 0.2, 1.0)]), small_stack())
    fit = fit_place(Scan(volume), np.array([0.5, 0.0, 1.2]), 11.5)
    assert fit.converged == is_pursued
    assert is_pursued or sum(settled) == 1


@pytest.mark.parametrize(("share", "is_pursued"), [(0.0, True), (1.01, False)])
def test_what_is_neither_at_rest_nor_round_after_the_first_steps_is_not_pursued(
    share: float, is_pursued: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    efforts = []

    def noting(*given):  # type: ignore[no-untyped-def]
        efforts.append(given[3] if len(given) > 3 else WHOLE)
        return descend(*given)

    def noting_on(*given):  # type: ignore[no-untyped-def]
        efforts.append(given[-1])
        return go_on(*given)

    monkeypatch.setattr(refine, "descend", noting)
    monkeypatch.setattr(refine, "go_on", noting_on)
    monkeypatch.setattr(refine, "BEGIN", Effort(1, 0.0, 0.0))
    monkeypatch.setattr(refine, "HOPELESS_SOON", share)
    monkeypatch.setattr(refine, "HOPELESS_ROUND", 1.01)  # what was given up stays so
    volume = scan(balls([(0.3, 0.2, 1.0)]), small_stack())
    fit = fit_place(Scan(volume), np.array([0.5, 0.0, 1.2]), 11.5)
    assert not fit.converged
    assert (REST in efforts) == is_pursued
    assert is_pursued or WHOLE not in efforts


def test_a_fit_that_comes_to_a_sphere_beside_its_candidate_starts_anew_there() -> None:
    volume, center_mm = scan(balls([(0.3, 0.2, 1.0)], 6.0), small_stack()), np.array([0.3, 0.2, 1.0])
    fit = fit_place(Scan(volume), np.array([0.3, 1.9, 1.0]), 6.0)
    assert fit.converged
    assert np.linalg.norm(fit.center_mm - center_mm) < 0.02


def test_the_first_steps_are_those_of_the_whole_descent() -> None:
    volume = scan(balls([(0.3, 0.2, 1.0)]), small_stack())
    around = gather(volume, np.array([0.3, 0.2, 1.0]), 10.0, volume.grid.axes)
    start = first_guess(around, 11.5, SOLID, 1.0)
    given = around, start, ball_prior(start, SOLID, is_clipped=False)
    whole, soon = descend(*given), descend(*given, BEGIN)
    assert whole[1]
    assert soon[1]
    assert np.array_equal(whole[0], soon[0])
    begun = go_on(*given[:2], FIRST_DAMPING, *given[2:], Effort(2, 0.0, 0.0))
    rest = go_on(around, begun[0], begun[2], *given[2:], REST)
    assert not begun[1]
    assert np.array_equal(whole[0], rest[0])
    assert not descend(*given, Effort(1, 0.0, 0.0))[1]
    assert descend(*given, Effort(1, 0.0, np.inf))[1]


def at_rest() -> tuple[Neighbourhood, FloatArray, Prior]:
    """Voxels about a ball, the parameters at which their descent comes to rest, and what was known before."""
    volume = scan(balls([(0.3, 0.2, 1.0)]), small_stack())
    around = gather(volume, np.array([0.3, 0.2, 1.0]), 10.0, volume.grid.axes)
    start = first_guess(around, 11.5, SOLID, 1.0)
    prior = ball_prior(start, SOLID, is_clipped=False)
    return around, descend(around, start, prior)[0], prior


def test_a_step_that_went_too_far_is_not_tried_again_at_the_same_length() -> None:
    around, theta, prior = at_rest()
    aside = theta.copy()
    aside[BLUR] = 0.8
    again, is_at_rest, _ = go_on(around, aside, LEAST_DAMPING, prior, Effort(8, 0.0, 0.0))
    assert is_at_rest
    assert np.abs(again - theta)[CENTER].max() < 1e-4


def test_what_is_at_rest_is_held_against_the_voxels_only_once(monkeypatch: pytest.MonkeyPatch) -> None:
    around, theta, prior = at_rest()
    equations, asked = descent._equations, []

    def counting(*given):  # type: ignore[no-untyped-def]
        asked.append(given)
        return equations(*given)

    monkeypatch.setattr(descent, "_equations", counting)
    monkeypatch.setattr(descent, "_descend", getattr(descent._descend, "py_func", descent._descend))
    again, is_at_rest = descend(around, theta, prior)
    assert is_at_rest
    assert np.array_equal(again, theta)
    assert len(asked) == 1


def test_what_turns_out_to_be_of_another_size_is_given_up_on_the_way_there() -> None:
    volume = scan(balls([(0.3, 0.2, 1.0)], diameter_mm=14.0), small_stack())
    around = gather(volume, np.array([0.3, 0.2, 1.0]), 10.0, volume.grid.axes)
    start = first_guess(around, 11.5, SOLID, 1.0)
    theta, is_at_rest = descend(around, start, ball_prior(start, SOLID, is_clipped=False))
    assert abs(2.0 * theta[RADIUS] - 11.5) > HOPELESS_SIZE * 11.5
    assert not is_at_rest  # left to itself, it would come to rest as the ball that is there


CENTER_MM, RADIUS_MM, POST_SHARE = np.array([0.2, -0.13, 0.31]), 4.0, 0.4
"""A ball, and the radius of a post that leads from it along x, as a share of the ball's."""


def by_a_sharp_kernel(
    pixel_mm: float = 0.4,
    passes_per_mm: float = 1.2,
    radius_mm: float = RADIUS_MM,
    *,
    averaged: bool = True,
    noise_hu: float = 15.0,
    turned: float = 0.0,
) -> CTVolume:
    """Images of a ball on its post by a kernel that overshoots, drawn finely, filtered, and averaged to pixels.

    Or they are read off at the pixels' centers.
    """
    fine, spacing_mm, count = 5, 0.7, round(24.0 / pixel_mm)
    places_mm = (np.arange(count * fine) - (count * fine - 1) / 2) * pixel_mm / fine
    x, y = np.meshgrid(places_mm - CENTER_MM[0], places_mm - CENTER_MM[1])
    x, y = x * np.cos(turned) + y * np.sin(turned), y * np.cos(turned) - x * np.sin(turned)
    frequencies = np.fft.fftfreq(count * fine, pixel_mm / fine)
    squares = (frequencies**2 + frequencies[:, np.newaxis] ** 2) / passes_per_mm**2
    passed = (1.0 + 3.0 * squares) * np.exp(-2.2 * squares)
    heights_mm = np.arange(-14, 15) * spacing_mm
    pictures_hu = []
    for height_mm in heights_mm:
        shares = np.zeros_like(x)
        for z in height_mm - CENTER_MM[2] + spacing_mm * np.array([-0.375, -0.125, 0.125, 0.375]):
            in_ball = x**2 + y**2 < radius_mm**2 - z**2
            shares += 0.25 * (in_ball | ((x > 0.0) & (y**2 < (POST_SHARE * radius_mm) ** 2 - z**2)))
        seen = np.fft.ifft2(np.fft.fft2(shares) * passed).real
        pixels = seen.reshape(count, fine, count, fine)
        told = pixels.mean(axis=(1, 3)) if averaged else pixels[:, fine // 2, :, fine // 2]
        pictures_hu.append(1500.0 * told - 1000.0)
    noise = noise_hu * np.random.default_rng(4).standard_normal((len(heights_mm), count, count))
    first_mm = -(count - 1) / 2 * pixel_mm
    origins_mm = np.array([[first_mm, first_mm, height_mm] for height_mm in heights_mm])
    grid = SliceGrid(origins_mm, np.array([0.0, pixel_mm, 0.0]), np.array([pixel_mm, 0.0, 0.0]), spacing_mm)
    return CTVolume(np.round(np.array(pictures_hu) + noise).astype(np.int16), grid)


def test_a_kernel_that_overshoots_is_not_taken_for_one_with_long_tails(monkeypatch: pytest.MonkeyPatch) -> None:
    scan_ = Scan(by_a_sharp_kernel())
    fit = fit_place(scan_, CENTER_MM, 2.0 * RADIUS_MM)
    assert fit.converged
    assert fit.theta[EDGE] > 0.3
    assert np.linalg.norm(fit.center_mm - CENTER_MM) < 0.002
    monkeypatch.setattr(refine, "_of_either_kernel", lambda fit, around: fit)
    other = fit_place(scan_, CENTER_MM, 2.0 * RADIUS_MM)
    assert other.theta[EDGE] < refine.LONG_TAILS
    assert other.misfit > 1.1 * fit.misfit


def test_long_tails_are_not_better_by_the_directions_that_they_leave_out(monkeypatch: pytest.MonkeyPatch) -> None:
    coarse = by_a_sharp_kernel(1.0, 0.9, 3.0, averaged=False, noise_hu=25.0, turned=1.4)
    fit = fit_place(Scan(coarse), CENTER_MM, 6.0)
    assert fit.converged
    assert fit.theta[EDGE] > 0.3
    monkeypatch.setattr(refine, "_of_either_kernel", lambda fit, around: fit)
    other = fit_place(Scan(coarse), CENTER_MM, 6.0)
    assert other.theta[EDGE] < refine.LONG_TAILS
    assert other.used.sum() < 0.6 * fit.used.sum()
    assert other.misfit < fit.misfit  # where it looks, it is the better
