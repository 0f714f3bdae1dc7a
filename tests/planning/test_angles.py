"""Angles of known directions, in the AC-PC frame and on arc and ring."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ronnaplan.errors import InputError
from ronnaplan.planning import Landmarks
from ronnaplan.planning.angles import RAS_IN_LPS, acpc_angles, acpc_from_lps, arc_angles, lps_from_acpc

SQUARE = Landmarks(np.array([0.0, -12.5, 0]), np.array([0.0, 12.5, 0]), np.array([0.0, 5, 50]))


@pytest.mark.parametrize(
    ("outward", "sagittal", "coronal"),
    [
        ((0, 0, 1), 90.0, 0.0),
        ((0, -1, 1), 45.0, 0.0),
        ((0, 1, 1), 135.0, 0.0),
        ((-1, 0, 1), 90.0, 45.0),
        ((1, 0, 1), 90.0, -45.0),
    ],
)
def test_ac_pc_angles(outward: tuple[float, ...], sagittal: float, coronal: float) -> None:
    angles = acpc_angles(SQUARE, np.array(outward) * 40.0, np.zeros(3))
    assert (angles.sagittal_deg, angles.coronal_deg) == pytest.approx((sagittal, coronal), abs=1e-9)
    assert angles.target_mm == pytest.approx((0.0, 0.0, 0.0))


def test_landmarks_may_be_lists_and_stay_as_they_were() -> None:
    """Lists were taken, and no angle could be computed of them."""
    given_mm: list[Any] = [[0.0, -12.5, 0], [0, 12.5, 0], np.array([0.0, 5, 50])]
    landmarks = Landmarks(*given_mm)
    given_mm[2] += 9.0
    assert acpc_angles(landmarks, np.array([0, 0, 40.0]), np.zeros(3)) == acpc_angles(
        SQUARE, np.array([0, 0, 40.0]), np.zeros(3)
    )
    np.testing.assert_array_equal(landmarks.midline_mm, SQUARE.midline_mm)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_ac_pc_angles_turn_with_the_head(seed: int) -> None:
    generator = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(generator.uniform(-0.7, 0.7, 3)).as_matrix()
    shift = generator.uniform(-50, 50, 3)
    entry, target = generator.uniform(-30, 30, (2, 3))
    turned = Landmarks(*(turn @ place + shift for place in (SQUARE.ac_mm, SQUARE.pc_mm, SQUARE.midline_mm)))
    before = acpc_angles(SQUARE, entry, target)
    after = acpc_angles(turned, turn @ entry + shift, turn @ target + shift)
    assert after.sagittal_deg == pytest.approx(before.sagittal_deg, abs=1e-6)
    assert after.coronal_deg == pytest.approx(before.coronal_deg, abs=1e-6)
    assert after.target_mm == pytest.approx(before.target_mm, abs=1e-9)
    place = lps_from_acpc(turned, np.array([-11.0, -3.0, -4.0]))  # left, behind and below the middle
    assert place == pytest.approx(turn @ [11.0, 3.0, -4.0] + shift, abs=1e-9)
    assert acpc_from_lps(turned, place) == pytest.approx([-11.0, -3.0, -4.0], abs=1e-9)


def test_landmarks_on_a_line_are_refused() -> None:
    with pytest.raises(InputError, match="one line"):
        Landmarks(np.array([0.0, 0, 0]), np.array([0.0, 25, 0]), np.array([0.0, 60, 0.2]))


@pytest.mark.parametrize(
    ("outward", "arc", "ring"),
    [((0, 0, 1), 90, 90), ((0, -1, 0), 90, 0), ((-1, 0, 1), 45, 90), ((1, 0, 1), 135, 90), ((0, -1, 1), 90, 45)],
)
def test_arc_and_ring(outward: tuple[float, ...], arc: float, ring: float) -> None:
    angles = arc_angles(np.array(outward) * 50.0 + 7.0, np.full(3, 7.0))
    assert (angles.arc_deg, angles.ring_deg) == pytest.approx((arc, ring))


@given(st.floats(1, 179), st.floats(-179, 179))
@settings(max_examples=40)
def test_arc_and_ring_lead_back_to_the_direction(arc: float, ring: float) -> None:
    a, r = np.radians([arc, ring])
    outward = np.array([np.cos(a), np.sin(a) * np.cos(r), np.sin(a) * np.sin(r)]) @ RAS_IN_LPS
    angles = arc_angles(outward * 60.0, np.zeros(3))
    assert (angles.arc_deg, angles.ring_deg) == pytest.approx((arc, ring), abs=1e-6)
