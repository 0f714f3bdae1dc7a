"""Of few points every pairing is weighed; a pair that was pointed at is not believed against all others."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.correspondence import match_points
from ronnaplan.correspondence.evidence import SCALE_PRIORS, SCALES
from ronnaplan.correspondence.priors import tail_beyond_gate
from tests.correspondence.scenes import HEAD, SIGMA_CT, SIGMA_OTS, is_right, scene


def test_a_pair_pointed_at_wrongly_is_not_believed() -> None:
    ct, ots, partner = scene(5, markers=6, outliers=0)
    pairing = match_points(ct, ots, known_pairs=[(0, int(partner[1])), (1, int(partner[2])), (2, int(partner[0]))])
    assert pairing.status != "unique"
    assert "check what was pointed at" in pairing.reason


def test_a_pair_pointed_at_is_not_blamed_where_nothing_fits() -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        ct, ots = rng.normal(0.0, 50.0, (2, 6, 3))
        for known in ([(0, 1)], [(0, 1), (1, 0), (2, 5)]):
            pairing = match_points(ct, ots, known_pairs=known)
            assert pairing.status != "unique"
            assert "pointed at" not in pairing.reason


def test_one_pair_pointed_at_wrongly_does_not_outweigh_all_others() -> None:
    """Of these, 19 were answered wrongly: all pairings that were considered held the pair given."""
    refused = 0
    for seed in range(300):
        ct, ots, partner = scene(seed, markers=6, outliers=2)
        i, other = np.random.default_rng(seed).permutation(6)[:2]
        pairing = match_points(ct, ots, expected=6, known_pairs=[(i, partner[other])])
        assert pairing.status != "unique", seed
        refused += "check what was pointed at" in pairing.reason
    assert refused > 0


def test_pairs_pointed_at_settle_regular_markers_however_the_noise_falls() -> None:
    corners = np.array(list(itertools.product([0.0, 60.0], repeat=3)))
    for seed in range(20):
        ct, ots, partner = scene(seed, 8, 0, layout=corners)
        pairing = match_points(ct, ots, known_pairs=[(i, partner[i]) for i in (0, 1)])
        assert is_right(pairing, partner), (seed, pairing.reason)


def test_every_pairing_of_a_small_case_is_weighed_as_brute_force_does() -> None:
    """An independent enumeration: all injective pairings, each by the documented formula with SciPy's rotation."""
    ct, ots, _ = scene(11, markers=4, outliers=1)
    c, spread = SIGMA_CT**2 + SIGMA_OTS**2, 60.0
    squares = [5 / 3 * np.trace(np.cov(points.T)) for points in (ct, ots)]
    volume = 4 / 3 * np.pi * (squares[0] * squares[1]) ** 0.75
    weights = {}
    for k in (3, 4, 5):
        count = sum(1 for _ in itertools.permutations(range(5), k)) * len(
            list(itertools.combinations(range(5), k))
        )
        for i in itertools.combinations(range(5), k):
            for j in itertools.permutations(range(5), k):
                x, y = ct[list(i)], ots[list(j)]
                x, y = x - x.mean(axis=0), y - y.mean(axis=0)
                chi2 = Rotation.align_vectors(y, x)[1] ** 2 / c
                information = (np.sum(x**2) * np.eye(3) - x.T @ x) / c + np.eye(3) / (2 * np.pi)
                scales = zip(SCALE_PRIORS, SCALES, strict=True)
                misfit = sum(w * s ** (6 - 3 * k) * np.exp(-chi2 / 2 / s**2) for w, s in scales)
                log_e = (
                    (k - 1) * (np.log(volume) + 1.5)
                    - np.log(8 * np.pi**2)
                    + (3 - 1.5 * k) * np.log(2 * np.pi)
                    - np.sum(x**2) / 2 / spread**2
                    - 1.5 * k * np.log(c)
                    - 1.5 * np.log(k / c)
                    - 0.5 * np.linalg.slogdet(information)[1]
                )
                weights[i, j] = 0.5 / 3 / count * np.exp(log_e) * misfit
    best = max(weights, key=weights.__getitem__)
    pairing = match_points(ct, ots)
    assert [(int(a), int(b)) for a, b in pairing.pairs] == list(zip(*best, strict=True))
    beyond_gate = np.mean([tail_beyond_gate(k) for k in (3, 4, 5)])
    chance = 0.5 + 0.5 * beyond_gate
    assert pairing.probability == pytest.approx(weights[best] / (sum(weights.values()) + chance), abs=1e-7)
    for rival in pairing.rivals:
        key = tuple(rival.pairs[:, 0].tolist()), tuple(rival.pairs[:, 1].tolist())
        assert rival.log_evidence_below == pytest.approx(np.log(weights[best] / weights[key]), abs=1e-4)
    held = [
        sum(w for key, w in weights.items() if pair in zip(*key, strict=True)) for pair in zip(*best, strict=True)
    ]
    assert pairing.pair_probabilities == pytest.approx(np.array(held) / (sum(weights.values()) + chance), abs=1e-7)


@pytest.mark.parametrize("expected", [6, None])
def test_a_marker_that_one_set_holds_twice_is_doubtful_and_the_rest_is_given(expected: int | None) -> None:
    """Whichever set it is: of markers read twice all were refused, of markers found twice in the scan none."""
    for seed in range(10):
        ct, ots, partner = scene(seed, markers=6, outliers=0)
        twice = np.vstack((ots, ots[partner[0]] + [0.3, 0.0, 0.4]))
        for pairing in (match_points(ct, twice, expected), match_points(twice, ct, expected).swapped()):
            assert pairing.pairs.tolist() == [[i, partner[i]] for i in range(1, 6)], seed
            assert pairing.doubtful[:, 0].tolist() == [0]
            assert pairing.doubtful[0, 1] in (partner[0], 6)
            assert len(pairing.moved) == 0, "it fits"


def read_twice(seed: int, markers: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A scene in which each set holds the first marker twice: the last points lie 2 mm beside it."""
    ct, ots, partner = scene(seed, markers, outliers=0)
    way = np.random.default_rng(seed).normal(size=(2, 3))
    way *= 2.0 / np.linalg.norm(way, axis=1, keepdims=True)
    return np.vstack((ct, ct[0] + way[0])), np.vstack((ots, ots[partner[0]] + way[1])), partner


def test_of_three_markers_one_of_which_was_read_twice_it_is_said_that_it_was() -> None:
    """Only the probability was told, a half."""
    ct, ots, partner = scene(0, markers=3, outliers=0)
    twice = np.vstack((ots, ots[partner[0]] + [0.3, 0.0, 0.4]))
    for pairing, name in ((match_points(ct, twice, 3), "readings"), (match_points(twice, ct, 3), "CT points")):
        assert pairing.status == "ambiguous"
        assert f"two {name} lie 0.5 mm apart: if one marker was read twice, leave one out" in pairing.reason
    square = [[0.0, 0.0, 0.0], [80.0, 0.0, 0.0], [80.0, 80.0, 0.0], [0.0, 80.0, 0.0]]
    assert "apart" not in match_points(square, square).reason, "markers far from each other are not read twice"


def test_of_pairs_side_by_side_neither_is_given() -> None:
    """Of a marker that both sets hold twice two pairs were given, one of them wrong, or all was refused."""
    for seed in range(20):
        ct, ots, partner = read_twice(seed, markers=6)
        pairing = match_points(ct, ots)
        assert pairing.pairs.tolist() == [[i, partner[i]] for i in range(1, 6)], (seed, pairing.reason)
        assert 0 in pairing.doubtful[:, 0]
        known = match_points(ct, ots, known_pairs=[(0, partner[0])])
        assert known.pairs.tolist() == [[i, partner[i]] for i in range(6)], "unless it was pointed at"


def test_of_two_markers_at_one_place_neither_is_given_but_all_others() -> None:
    """All were refused."""
    layout = np.vstack((HEAD[:5], HEAD[:1]))
    assert match_points(layout, layout + 7.0, expected=6).pairs.tolist() == [[i, i] for i in range(1, 5)]


def test_nothing_is_given_where_too_few_pairs_lie_by_themselves() -> None:
    pairing = match_points(*read_twice(3, markers=3)[:2])
    assert pairing.status == "unmatched"
    assert "2 pairs are left" in pairing.reason
    assert "read twice" in pairing.reason
