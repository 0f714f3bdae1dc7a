import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ronnaplan.correspondence import match_by_similarity, match_points
from ronnaplan.correspondence.told import Told
from ronnaplan.errors import InputError, RonnaplanError
from tests.correspondence.scenes import HEAD, SIGMA_CT, SIGMA_OTS, ball, is_right, scene
from tests.long import few_and_others


@pytest.mark.parametrize(("markers", "outliers"), [(4, 0), (4, 4), (5, 2), (8, 0), (8, 4)])
def test_markers_are_paired_among_outliers(markers: int, outliers: int) -> None:
    for seed in range(20):
        ct, ots, partner = scene(seed, markers, outliers)
        pairing = match_points(ct, ots, expected=markers)
        assert pairing.status == "unique", (seed, pairing.reason)
        assert is_right(pairing, partner)
        assert pairing.probability > 0.99


def test_the_number_of_markers_is_inferred_when_some_are_hidden() -> None:
    for seed in range(20):
        for hidden in (1, 2):
            ct, ots, partner = scene(seed, outliers=2, hidden=hidden)
            assert is_right(match_points(ct, ots), partner), (seed, hidden)


def test_more_pairs_than_expected_are_refused_and_shown() -> None:
    ct, ots, partner = scene(1, markers=6, outliers=2)
    pairing = match_points(ct, ots, expected=5)
    assert pairing.status == "unmatched"
    assert len(pairing.pairs) == 0
    assert "6 pairs fit but 5 are expected" in pairing.reason
    assert np.array_equal(pairing.rivals[0].pairs[:, 1], partner[partner >= 0])


def test_a_few_pairs_less_than_expected_are_given_and_many_less_refused() -> None:
    ct, ots, partner = scene(1, markers=6, outliers=2)
    assert is_right(match_points(ct, ots, expected=7), partner)
    ct, ots, partner = scene(1, markers=5, outliers=4)
    assert "5 pairs fit but 9 are expected" in match_points(ct, ots, expected=9).reason


@pytest.mark.parametrize("side", [0, 1])
def test_a_marker_that_one_set_lacks_is_no_reason_to_refuse_the_others(side: int) -> None:
    """Only among strays were the others given: six markers and five readings were an error of the input."""
    for seed in range(20):
        ct, ots, partner = scene(seed, markers=6, outliers=0, hidden=1)
        sets = (ct, ots) if side == 0 else (ots, ct)
        pairing = match_points(*sets, expected=6)
        assert is_right(pairing if side == 0 else pairing.swapped(), partner), (seed, pairing.reason)


def test_too_few_points_for_the_number_told_are_refused_by_how_many_pair() -> None:
    """They were an error of the input, of which nothing is shown; three of four are too easily had."""
    cases: list[tuple[dict[str, Any], int, str]] = [
        ({"expected": 4}, 5, "3 pairs fit but 4 are expected"),
        ({"expected": 8}, 4, "4 pairs fit but 8 are expected"),
        ({"expected": 10_000}, 0, "8 pairs fit but 10000 are expected"),
        ({"at_least": 8}, 1, "7 pairs fit but at least 8 are expected"),
    ]
    for number, hidden, reason in cases:
        ct, ots, partner = scene(1, outliers=0, hidden=hidden)
        pairing = match_points(ct, ots, **number)
        assert pairing.status == "unmatched"
        assert reason in pairing.reason
        assert pairing.rivals[0].pairs[:, 1].tolist() == partner[partner >= 0].tolist()


def test_markers_that_are_missing_make_another_patient_more_probable() -> None:
    """Four of six pair with the odds to "nothing pairs" that they have where strays stand for the missing ones."""
    odds = [prior[4] / prior[0] for prior in (Told(expected=6).prior(range(3, most + 1)) for most in (4, 5, 6))]
    assert odds == pytest.approx([odds[-1]] * 3)


@pytest.mark.parametrize("markers", [5, 8])
def test_a_marker_that_moved_is_left_out_and_named(markers: int) -> None:
    """Telling eight refused 80 % of these before."""
    left_out = named = 0
    for seed in range(40):
        ct, ots, partner = scene(seed, markers=markers, outliers=0)
        rng = np.random.default_rng(seed)
        direction = rng.normal(size=3)
        ct[1] += direction / np.linalg.norm(direction) * rng.uniform(6, 15)
        pairing = match_points(ct, ots, expected=markers)
        assert all(partner[i] == j for i, j in pairing.pairs), seed
        left_out += len(pairing.pairs) == markers - 1 and 1 not in pairing.pairs[:, 0]
        named += [1, partner[1]] in pairing.moved.tolist()
    assert left_out >= 32
    assert named >= left_out


def test_of_four_markers_one_of_which_moved_no_other_four_are_given() -> None:
    """Three are right then, fewer than are given; when these were no rivals, 20 were given, one of them wrongly."""
    given = 0
    for seed in range(120):
        rng = np.random.default_rng(seed)
        layout = rng.normal(size=(4, 3))
        layout *= 85 / np.linalg.norm(layout, axis=1, keepdims=True)
        ct, ots, partner = scene(seed, markers=4, outliers=seed % 4, radius=150.0, layout=layout)
        direction = rng.normal(size=3)
        ots[partner[1]] += direction / np.linalg.norm(direction) * 15
        pairing = match_points(ct, ots, expected=4)
        assert all(partner[i] == j for i, j in pairing.pairs), seed
        given += pairing.status == "unique"
    assert given <= 6


def test_at_least_so_many_is_enough_to_know_that_it_is_this_patient() -> None:
    told, untold = 0, 0
    for seed in range(60):
        ct, ots, partner = scene(seed, markers=3, outliers=4)
        told += is_right(match_points(ct, ots, at_least=3), partner)
        untold += is_right(match_points(ct, ots), partner)
    assert told > untold
    assert match_points(ct, ots, at_least=4).status != "unique"


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), shift=st.floats(-2000, 2000))
def test_the_answer_follows_rotation_translation_and_permutation(seed: int, shift: float) -> None:
    ct, ots, _partner = scene(seed, markers=6, outliers=2)
    rng = np.random.default_rng(seed)
    before = match_points(ct, ots, expected=6)
    order = rng.permutation(len(ct))
    moved = Rotation.from_quat(rng.normal(size=4)).apply(ct[order]) + shift
    after = match_points(moved, ots, expected=6)
    assert after.status == before.status
    assert after.probability == pytest.approx(before.probability, abs=1e-6)
    assert {(int(order[i]), int(j)) for i, j in after.pairs} == {(int(i), int(j)) for i, j in before.pairs}


def test_swapping_the_sets_swaps_the_pairs() -> None:
    ct, ots, _ = scene(3, markers=6, outliers=0)
    forth, back = match_points(ct, ots), match_points(ots, ct, sigma_ct_mm=SIGMA_OTS, sigma_ots_mm=SIGMA_CT)
    assert {(i, j) for i, j in forth.pairs.tolist()} == {(i, j) for j, i in back.pairs.tolist()}


def test_scaling_points_and_errors_alike_changes_no_pair() -> None:
    ct, ots, _ = scene(4, markers=6, outliers=2)
    once = match_points(ct, ots)
    twice = match_points(2 * ct, 2 * ots, sigma_ct_mm=1.12, sigma_ots_mm=0.34, spread_mm=120.0)
    assert np.array_equal(once.pairs, twice.pairs)
    assert twice.probability == pytest.approx(once.probability, abs=1e-9)


SYMMETRIC = {
    "equilateral triangle": (np.array([[0, 0, 0], [100, 0, 0], [50, 50 * 3**0.5, 0]]), 6),
    "square": (np.array([[0, 0, 0], [80, 0, 0], [80, 80, 0], [0, 80, 0.0]]), 8),
    "flat and mirror-symmetric": (np.array([[0, 0, 0], [90, 40, 0], [90, -40, 0], [130, 0, 0.0]]), 2),
}


@pytest.mark.parametrize("name", SYMMETRIC)
def test_symmetric_layouts_are_ambiguous_and_one_touch_tells_which(name: str) -> None:
    layout, orders = SYMMETRIC[name]
    pairing = match_points(layout, layout + 7.0, expected=len(layout))
    assert pairing.status == "ambiguous"
    assert len(pairing.pairs) == 0
    assert pairing.probability == pytest.approx(1 / orders, rel=1e-3)
    assert sum(rival.log_evidence_below < 1e-6 for rival in pairing.rivals) == orders
    assert pairing.touch is not None
    partners = {int(rival.pairs[pairing.touch, 1]) for rival in pairing.rivals}
    assert len(partners) > 1


def test_a_mirror_symmetric_layout_out_of_plane_is_not_confused_with_its_mirror_image() -> None:
    layout = np.array([[0, 0, 0], [90, 40, 0], [90, -40, 0], [130, 0, 60.0], [60, 0, 90.0]])
    pairing = match_points(layout, layout, expected=5)
    assert pairing.status == "unique"
    assert np.array_equal(pairing.pairs[:, 0], pairing.pairs[:, 1])


def test_pointed_at_pairs_are_honoured_and_settle_a_square() -> None:
    square = SYMMETRIC["square"][0]
    pairing = match_points(square, square, expected=4, known_pairs=[(0, 1), (1, 2)])
    assert pairing.status == "unique"
    assert pairing.pairs.tolist() == [[0, 1], [1, 2], [2, 3], [3, 0]]
    one = match_points(square, square, expected=4, known_pairs=[(0, 1)])
    assert one.status == "ambiguous"
    assert all([0, 1] in rival.pairs.tolist() for rival in one.rivals)


def test_touching_the_named_point_resolves_what_was_ambiguous() -> None:
    triangle = np.array([[0, 0, 0], [100, 0, 0], [50.5, 86.6, 0.0]])
    ambiguous = match_points(triangle, triangle, expected=3)
    assert ambiguous.status == "ambiguous"
    touched = ambiguous.touch
    assert touched is not None
    settled = match_points(triangle, triangle, expected=3, known_pairs=[(touched, touched)])
    assert settled.probability > ambiguous.probability


def test_readings_of_another_patient_are_told_from_too_few_of_this_one() -> None:
    """Where no three pairs agreed, too many pairings were said to fit, and more readings asked for."""
    for count in (3, 6):
        pairing = match_points(HEAD[:count], 5.0 * HEAD[:3])
        assert pairing.status == "unmatched"
        assert "no three pairs agree in their distances; check" in pairing.reason
    crowd = np.random.default_rng(4).normal(size=(400, 3)) * 60
    pairing = match_points(crowd[:3], crowd)
    assert pairing.status == "ambiguous"
    assert "3 CT points with 400 readings" in pairing.reason
    assert "have more of the markers read" in pairing.reason


def test_sets_that_may_be_in_centimetres_are_refused_with_that() -> None:
    """A head of 200 mm is one of 20 there, and errors in mm are so large that much fits."""
    rng = np.random.default_rng(3)
    ct = rng.uniform(-100, 100, (8, 3))
    seen = Rotation.random(random_state=1).apply(ct[:5]) + rng.normal(0, 0.3, (5, 3))
    ots = np.vstack([seen, rng.uniform(-100, 100, (3, 3))])
    assert match_points(ct, ots).status == "unique"
    small = match_points(ct / 10, ots / 10)
    assert small.status != "unique"
    assert small.reason.endswith("less than 30 mm: if they are in cm, convert them to millimetres")
    for others in (ots, ct):  # the spread of one set is enough to tell that it is in mm
        refused = match_points(others / 10, rng.uniform(-100, 100, (8, 3)))
        assert refused.reason
        assert "cm" not in refused.reason


def test_collinear_markers_are_refused() -> None:
    line = np.array([[0, 0, 0], [50, 0.2, 0], [80, 0, 0.3], [170, 0, 0.0]])
    pairing = match_points(line, line, expected=4)
    assert pairing.status == "ambiguous"
    assert "one line" in pairing.reason


@few_and_others(("count", "tests"), [(3, 300), (4, 300)], [(8, 300), (12, 60)])
def test_the_markers_of_another_patient_are_refused(count: int, tests: int) -> None:
    rng = np.random.default_rng(count)
    statuses = [match_points(ball(rng, count, 100.0), ball(rng, count, 100.0)).status for _ in range(tests)]
    assert statuses.count("unique") <= 1


def test_a_layout_of_countless_orders_is_refused_not_listed() -> None:
    crowd = np.zeros((12, 3))
    crowd[:, 0] = 0.2 * np.arange(12)
    pairing = match_points(crowd, crowd)
    assert pairing.status == "ambiguous"
    assert pairing.probability == 0.0


def test_anisotropic_errors_equal_in_all_directions_change_nothing() -> None:
    ct, ots, _ = scene(6, markers=5, outliers=2)
    plain = match_points(ct, ots, expected=5)
    covariances = [np.tile(s**2 * np.eye(3), (7, 1, 1)) for s in (SIGMA_CT, SIGMA_OTS)]
    full = match_points(ct, ots, expected=5, covariances_ct_mm2=covariances[0], covariances_ots_mm2=covariances[1])
    assert np.array_equal(plain.pairs, full.pairs)
    assert full.probability == pytest.approx(plain.probability, abs=1e-7)


def test_one_covariance_stands_for_those_of_all_points() -> None:
    """As in `register_points`; it was refused, whose errors are the same everywhere had to repeat it."""
    ct, ots, _ = scene(6, markers=5, outliers=2)
    one = np.diag([0.3, 0.2, 0.5]) ** 2
    each, all_ = (
        match_points(ct, ots, expected=5, covariances_ct_mm2=stated, covariances_ots_mm2=stated)
        for stated in (np.tile(one, (7, 1, 1)), one.tolist())
    )
    assert np.array_equal(each.pairs, all_.pairs)
    assert each.probability == all_.probability


def test_stating_that_one_axis_is_poor_finds_markers_that_a_round_error_would_lose() -> None:
    rng = np.random.default_rng(7)
    covariance = np.diag([0.2, 0.2, 2.5]) ** 2
    ots = HEAD + rng.multivariate_normal(np.zeros(3), covariance, len(HEAD))
    stated = match_points(
        HEAD, ots, expected=8, sigma_ct_mm=0.1, covariances_ots_mm2=np.tile(covariance, (8, 1, 1))
    )
    believed_round = match_points(HEAD, ots, expected=8, sigma_ct_mm=0.1, sigma_ots_mm=0.2)
    assert len(stated.pairs) == 8
    assert len(believed_round.pairs) < 8


def test_one_badly_read_marker_needs_its_own_sigma() -> None:
    ct, ots, partner = scene(8, markers=6, outliers=0)
    ct[2] += [9.0, -8.0, 8.0]
    sigma = np.full(6, SIGMA_CT)
    sigma[2] = 9.0
    assert is_right(match_points(ct, ots, expected=6, sigma_ct_mm=sigma), partner)
    believed_good = match_points(ct, ots, expected=6)
    assert 2 not in believed_good.pairs[:, 0]
    assert believed_good.moved.tolist() == [[2, partner[2]]]


def test_four_markers_are_found_among_two_hundred_reflections() -> None:
    rng = np.random.default_rng(9)
    reflections = np.vstack((HEAD[:4] + SIGMA_OTS * rng.normal(size=(4, 3)), ball(rng, 196, 300.0)))
    pairing = match_points(HEAD[:4], reflections, expected=4)
    assert pairing.status == "unique"
    assert pairing.pairs.tolist() == [[0, 0], [1, 1], [2, 2], [3, 3]]


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "fewer than three": ({"ct_points": HEAD[:2]}, "at least 3"),
    "more than kernels number": ({"ots_points": np.zeros((10_001, 3))}, "at most 10000"),
    "not (N, 3)": ({"ct_points": HEAD[:, :2]}, r"expected \(N, 3\)"),
    "NaN": ({"ots_points": np.where(HEAD > 90, np.nan, HEAD)}, "finite"),
    "metres": ({"ct_points": HEAD / 1000}, "millimetres"),
    "micrometres": ({"ots_points": HEAD * 1000}, "millimetres"),
    "sigma zero": ({"sigma_ct_mm": 0.0}, "positive"),
    "sigma NaN": ({"sigma_ots_mm": np.nan}, "positive"),
    "sigmas of another set": ({"sigma_ct_mm": np.ones(3)}, "shape"),
    "covariance not positive": ({"covariances_ct_mm2": np.zeros((8, 3, 3))}, "positive definite"),
    "covariance too small for a tracker": (
        {"covariances_ots_mm2": np.tile(1e-300 * np.eye(3), (8, 1, 1))},
        "1e-06",
    ),
    "covariance beyond reason": ({"covariances_ct_mm2": np.tile(1e12 * np.eye(3), (8, 1, 1))}, "1e\\+06 mm along"),
    "covariances of other points": (
        {"covariances_ct_mm2": np.tile(np.eye(3), (7, 1, 1))},
        r"\(3, 3\) for all or \(8,",
    ),
    "sigma as a covariance": ({"covariances_ots_mm2": 0.2}, r"shape \(\); .* as sigma"),
    "sigmas as covariances": ({"covariances_ct_mm2": np.full(8, 0.2)}, r"shape \(8,\); .* as sigma"),
    "one covariance not symmetric": ({"covariances_ct_mm2": np.triu(np.ones((3, 3)))}, "positive definite"),
    "expected too many": ({"expected": 10_001}, "10001 pairs are expected; .* 10000 at most"),
    "expected too few": ({"expected": 2}, "at least 3"),
    "at least too many": ({"at_least": 10_001}, "10001 pairs are the least"),
    "expected and at least": ({"expected": 4, "at_least": 3}, "only one"),
    "unknown known pair": ({"known_pairs": [(0, 8)]}, "known pairs"),
    "known pair twice": ({"known_pairs": [(0, 1), (0, 2)]}, "known pairs"),
    "known pair of three": ({"known_pairs": [(0, 1, 2)]}, "known pairs are"),
    "known pairs no list": ({"known_pairs": 5}, "known pairs are"),
    "known pair of fractions": ({"known_pairs": [(0.5, 1)]}, "known pairs are"),
    "light years": ({"ct_points": 1e298 * HEAD}, "beyond"),
    "complex": ({"ots_points": HEAD + 1j}, "complex"),
    "sigma without end": ({"sigma_ct_mm": 1e300}, "positive"),
    "level above one": ({"least_probability": 1.5}, "probability"),
    "field without end": ({"field_radius_mm": float("inf")}, "positive lengths"),
    "field beyond reason": ({"field_radius_mm": 1e200}, "positive lengths"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_told_in_one_sentence(name: str) -> None:
    wrong, message = BAD[name]
    arguments: dict[str, Any] = {"ct_points": HEAD, "ots_points": HEAD} | wrong
    with pytest.raises(InputError, match=message):
        match_points(**arguments)


@pytest.mark.parametrize("number", ["5", float("nan"), float("inf"), 4.5])
def test_a_number_of_pairs_that_is_none_is_told_in_one_sentence(number: Any) -> None:
    for name in ("expected", "at_least"):
        with pytest.raises(RonnaplanError, match="whole number"):
            match_points(HEAD, HEAD, **{name: number})


def test_points_that_may_not_be_written_to_are_matched() -> None:
    """As pandas, xarray and memory maps hand them on; kernels compiled for others raised numba's error."""
    for points in (HEAD, ball(np.random.default_rng(1), 40, 90.0)):
        fixed = points.copy()
        fixed.setflags(write=False)
        assert len(match_points(fixed, fixed + 3.0)) == len(points)
        assert len(match_by_similarity(fixed, fixed + 3.0, len(points))) == len(points)


def test_importing_the_room_does_not_load_numba() -> None:
    code = "import sys, ronnaplan.correspondence; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_reading_that_is_hardly_known_puts_the_others_on_no_line() -> None:
    """As of a label that jumps between two markers: six were refused as on one line."""
    rng = np.random.default_rng(7)
    places = rng.normal(0.0, 50.0, (6, 3))
    errors = np.array([0.17, 0.17, 100.0, 0.17, 0.17, 0.17])
    answer = match_points(places, places + errors[:, None] * rng.normal(size=(6, 3)), sigma_ots_mm=errors)
    assert (answer.status, np.delete(np.arange(6), 2).tolist()) == ("unique", answer.pairs[:, 0].tolist())


def test_points_on_a_line_whose_errors_differ_are_refused() -> None:
    along = np.array([[-80.0, 0.0, 0.0], [-20.0, 0.0, 0.0], [35.0, 0.0, 0.0], [90.0, 0.0, 0.0]])
    errors_mm2 = np.array([np.diag([0.01, 0.02, 0.03]) * (1 + n) for n in range(4)])
    answer = match_points(along, along + 5.0, covariances_ct_mm2=errors_mm2, covariances_ots_mm2=errors_mm2)
    assert answer.status == "ambiguous"
