"""What a scan's markers show alike of a head that moved."""

from __future__ import annotations

import numpy as np

from ronnaplan.localization.judge.motion import PATTERN_ERRORS_MM, PATTERNS, Movement
from ronnaplan.localization.scanwide.moving import suspected


def showing(pattern: str, errors: float) -> Movement:
    """Return a marker that shows one pattern by so many standard errors, and no other."""
    amplitudes_mm = np.where(np.array(PATTERNS) == pattern, errors * PATTERN_ERRORS_MM, 0.0)
    return Movement(amplitudes_mm, np.zeros(len(PATTERNS)))


def test_a_jump_that_two_markers_show_alike_is_told_by_all() -> None:
    """Each by itself shows too little; markers above and below stood in two places, though they show nothing."""
    still, moved = [showing("drift u", 0.4)] * 4, showing("jump u at +0.0", 2.5)
    assert suspected([*still, moved, moved]) == [True] * 6
    assert suspected([*still, moved, showing("jump u at +0.0", -2.5)]) == [False] * 6
    assert suspected([*still, moved]) == [False] * 5
    assert suspected([*still, *[showing("jump w at +0.0", 2.5)] * 2]) == [False] * 6
    assert suspected([*[showing("drift u", 0.8)] * 4, moved, moved]) == [False] * 6


def test_what_all_markers_of_a_cone_beam_show_from_slice_to_slice_is_told_by_none() -> None:
    """Rays that slant make it, in one direction here and in another there; edges within the slices tell as ever."""
    usual = [showing("drift u", sign * 2.5) for sign in (1.0, -1.0, 1.0, -1.0, 1.0)]
    assert suspected([*usual, showing("drift u", -6.0)]) == [*[False] * 5, True]
    assert suspected([*usual, showing("drift u", -6.0)], in_cubes=True) == [False] * 6
    assert suspected([*usual, showing("drift u", -9.0)], in_cubes=True) == [*[False] * 5, True]
    assert suspected([*usual, showing("third cos", 6.0)], in_cubes=True) == [*[False] * 5, True]
    still = [showing("drift u", sign * 0.5) for sign in (1.0, -1.0, 1.0, -1.0, 1.0)]
    assert suspected([*still, showing("drift u", -6.0)], in_cubes=True) == [*[False] * 5, True]


def test_little_that_all_markers_show_is_told_unless_a_cone_beam_makes_it() -> None:
    """A head that drifts in the turns of an axial scan bends every ball by 7 um in one sense; no still scan by 1."""
    bent = [showing("third sin", 1.75)] * 20
    assert suspected(bent) == [True] * 20
    assert suspected(bent, in_cubes=True) == [False] * 20
    assert suspected([*bent[:9], *[showing("third sin", 0.2)] * 11]) == [False] * 20


def test_what_three_markers_of_one_turn_show_alike_is_told_by_all() -> None:
    """A head that jumped while one turn made 20 mm of slices: their markers, off by 0.2 mm, each show too little."""
    still, bent = [showing("drift u", 0.4)] * 5, showing("across sin", 3.3)
    assert suspected([*still, bent, bent, bent]) == [True] * 8
    assert suspected([*still, bent, bent]) == [False] * 7
    assert suspected([*still, bent, bent, showing("across sin", -3.3)]) == [False] * 8
    assert suspected([*still, bent, bent, bent], in_cubes=True) == [False] * 8
