"""Markers of a scan and readings in any order become a registration, or a refusal."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ronnaplan.errors import FrameMismatchError, InputError, UsageError
from ronnaplan.geometry import Points
from ronnaplan.registration.marker_registration import register_markers
from tests.registration import scene


def test_readings_in_any_order_with_one_hidden_and_one_stray_register_the_head() -> None:
    seen = scene.readings(order=(3, 0, 4, 1))
    stray = Points(
        np.vstack([seen.positions_mm, [[300.0, 100, -1200]]]),
        np.concatenate([seen.covariances_mm2, seen.covariances_mm2[:1]]),
        (*seen.labels, "stray"),
        seen.frame,
    )
    found = register_markers(scene.ct_points(), stray)
    assert found.pairing.status == "unique"
    assert found.registration is not None
    assert found.registration.labels == ("F1", "F2", "F4", "F5")
    assert found.unpaired_ct == ("F3",)
    assert found.unpaired_ots == ("stray",)
    np.testing.assert_allclose(found.registration.transform[:3, 3], scene.SHIFT, atol=1.0)
    assert found.registration.pose.from_frame == scene.CT


def test_the_stated_ct_error_widens_the_expected_error() -> None:
    tight, loose = (register_markers(scene.ct_points(), scene.readings(), sigma_ct_mm=s) for s in (0.05, 0.5))
    assert tight.registration is not None
    assert loose.registration is not None
    assert loose.registration.tre_rms_mm([[0, 0, 0]])[0] > 2 * tight.registration.tre_rms_mm([[0, 0, 0]])[0]


def test_a_symmetric_layout_is_refused_until_a_marker_is_pointed_at() -> None:
    square = np.array([[60.0, 0, 0], [0, 60, 0], [-60, 0, 0], [0, -60, 0]])
    small = np.tile(0.01 * np.eye(3), (4, 1, 1))
    ct = Points(square, small, ("A", "B", "C", "D"), scene.CT)
    ots = Points(square @ scene.TURN.T + scene.SHIFT, small, ("1", "2", "3", "4"), scene.OTS)
    refused = register_markers(ct, ots, sigma_ct_mm=0.1)
    assert refused.pairing.status == "ambiguous"
    assert refused.registration is None
    assert refused.unpaired_ct == ct.labels
    pointed = register_markers(ct, ots, sigma_ct_mm=0.1, known_pairs=(("A", "1"), ("B", "2")))
    assert pointed.registration is not None
    np.testing.assert_allclose(pointed.registration.transform, scene.OTS_FROM_CT, atol=1e-6)


def test_unusable_requests_are_named() -> None:
    with pytest.raises(UsageError, match="no CT marker F9"):
        register_markers(scene.ct_points(), scene.readings(), known_pairs=(("F9", "1"),))
    with pytest.raises(UsageError, match="F1, F1"):
        register_markers(scene.ct_points(), scene.readings(), known_pairs=(("F1", "1"), ("F1", "2")))
    for sigma in (float("nan"), -1.0, 1e300):
        with pytest.raises(InputError, match="zero or more"):
            register_markers(scene.ct_points(), scene.readings(), sigma_ct_mm=sigma)


def test_a_marker_that_is_pointed_at_is_the_only_one_of_its_name() -> None:
    """The first of two was taken."""
    ct, ots = scene.ct_points(), scene.readings()
    twice = Points(ct.positions_mm, ct.covariances_mm2, ("F1", "F1", "F3", "F4", "F5"), ct.frame)
    with pytest.raises(UsageError, match="several CT markers are named F1; expected one"):
        register_markers(twice, ots, known_pairs=(("F1", "2"),))
    assert register_markers(twice, ots, known_pairs=(("F3", "4"),)).registration is not None


@pytest.mark.parametrize("known", [("F1", "1"), (("F1", "1"), ("F2",)), (("F1", "1", "2"),), (1,)])
def test_known_pairs_that_are_no_pairs_are_told(known: Any) -> None:
    with pytest.raises(UsageError, match=r"expected pairs of \(CT label, tracker label\)"):
        register_markers(scene.ct_points(), scene.readings(), known_pairs=known)


def test_pairs_that_are_not_certain_enough_are_named() -> None:
    found = register_markers(scene.ct_points(), scene.readings(), sigma_ct_mm=0.1)
    doubted = replace(found, pairing=replace(found.pairing, doubtful=np.array([[0, 1]])))
    assert found.notes == ()
    assert doubted.notes == ("marker F1 and reading 2 were left out: they fit, but not certainly enough",)


def test_fewer_markers_than_expected_are_told() -> None:
    """A marker that neither the scan nor the tracker shows stands in no list."""
    ct, ots = scene.ct_points(), scene.readings(order=(0, 1, 2, 3))
    ct = Points(ct.positions_mm[:4], ct.covariances_mm2[:4], ct.labels[:4], ct.frame)
    assert register_markers(ct, ots, expected=5, sigma_ct_mm=0.1).notes == ("4 markers pair where 5 are expected",)
    assert register_markers(ct, ots, expected=4, sigma_ct_mm=0.1).notes == ()


def test_a_scan_whose_distances_are_wrong_is_told_by_how_much() -> None:
    ct = scene.ct_points()
    short = Points(0.985 * ct.positions_mm, ct.covariances_mm2, ct.labels, ct.frame)
    (told,) = register_markers(short, scene.readings(), sigma_ct_mm=0.1).notes
    assert re.fullmatch(
        r"the readings would fit a scan that is longer by \+1\.\d %, \+1\.\d %, \+1\.\d % along x, y and z", told
    )


def test_a_scan_and_a_tracker_that_have_changed_places_are_refused() -> None:
    with pytest.raises(FrameMismatchError, match="the scan's first"):
        register_markers(scene.readings(), scene.ct_points())
