"""Proposed markers obey the law of the expected error, keep their rules, and beat even and random spreads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import box
from phantoms.stack import axial_stack
from ronnaplan.correspondence import describe_layout, match_points
from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.planning import Head, place_markers
from ronnaplan.planning.candidates import spread_directions
from ronnaplan.planning.placement import expected_tre_mm, scattered_layout
from ronnaplan.planning.sites import PlacementRules, Sites, allowed_sites, even_layout, scalp_sites, surface_sites
from ronnaplan.registration import register_points
from tests.long import few_or_all
from tests.planning.heads import SCALP, layered_head, normal, scanned
from tests.scans import scan

TARGETS = np.array([[12.0, -8.0, 18.0], [-6.0, 10.0, 5.0]])
ENTRIES = np.array([[30.0, -40.0, 62.0]])
RULES = PlacementRules(tracker=(0.0, -1.0, 0.5), visible_deg=75.0, lowest_mm=-20.0)


def half_scalp(count: int) -> Sites:
    """The upper half of the scalp as a surface alone, without a scan; of so many places all round."""
    directions = spread_directions(count)
    points = directions / np.linalg.norm(directions / SCALP, axis=1)[:, None]
    return surface_sites(points[points[:, 2] > -30.0], np.zeros(3))


@pytest.fixture(scope="module")
def sites() -> Sites:
    return half_scalp(600)  # 418 places are enough to choose from


def test_places_in_the_lower_half_are_named_unless_a_lowest_is_said(sites: Sites) -> None:
    free = place_markers(sites, TARGETS, 6, replace(RULES, lowest_mm=None))
    low = [f"M{n}" for n, place in enumerate(free.scalp_mm, 1) if place[2] < 0.0]
    assert low
    assert free.doubt is not None
    assert free.doubt.endswith(f"perhaps on face or neck: {', '.join(low)}; look at them")  # for page and command
    assert place_markers(sites, TARGETS, 6, RULES).doubt is None
    upper = sites.chosen(sites.scalp_mm[:, 2] > 0.0)
    assert place_markers(upper, TARGETS, 6, replace(RULES, lowest_mm=None)).doubt is None


def test_the_scalp_of_a_scan_gives_the_same_sites() -> None:
    sites = scalp_sites(scanned("tilted"), 1500)
    assert len(sites) > 600
    on_ellipsoid = np.linalg.norm(sites.scalp_mm / SCALP, axis=1)
    assert np.abs(on_ellipsoid - 1.0).max() < 0.01
    away = sites.scalp_mm[:, 2] > 30.0  # at the cut edge of the scan the slope is one-sided
    cosines = [n @ normal(p, SCALP) for n, p in zip(sites.normals[away], sites.scalp_mm[away], strict=True)]
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < 3.0


def test_nothing_is_placed_under_a_headrest() -> None:
    plate = Part(box((0.0, 98.0, 8.0), (70.0, 5.0, 50.0)), "acrylic", "headrest", embedded=True)
    stack = axial_stack(start_mm=-22, stop_mm=90, spacing_mm=2.0, matrix=128, field_of_view_mm=220.0)
    under = []
    for scene in (layered_head(), layered_head() + Scene((plate,))):
        places = scalp_sites(Head.of(scan(scene, stack)), 1500).scalp_mm
        near = (np.abs(places[:, 0]) < 20) & (places[:, 1] > 0) & (np.abs(places[:, 2] - 8) < 12)
        under.append(int(near.sum()))
    assert under[0] > 10
    assert under[1] == 0


def test_the_rules_are_kept(sites: Sites) -> None:
    placed = place_markers(sites, TARGETS, 6, RULES, ENTRIES)
    assert len(placed.centers_mm) == 6
    apart = np.linalg.norm(placed.centers_mm[:, None] - placed.centers_mm, axis=-1)[~np.eye(6, dtype=bool)]
    assert apart.min() >= RULES.least_apart_mm
    assert np.linalg.norm(placed.scalp_mm - ENTRIES[0], axis=1).min() >= RULES.least_from_entries_mm
    assert RULES.tracker is not None
    tracker = unit(RULES.tracker)
    assert (placed.normals @ tracker).min() >= np.cos(np.radians(RULES.visible_deg)) - 1e-9
    assert placed.scalp_mm[:, 2].min() >= -20.0
    np.testing.assert_allclose(placed.centers_mm - placed.scalp_mm, RULES.height_mm * placed.normals, atol=1e-9)
    assert placed.refusal_probability <= 0.01
    assert placed.rival_distance_mm == pytest.approx(describe_layout(placed.centers_mm).rival_distance_mm)


def test_more_markers_are_better_and_none_is_on_a_line(sites: Sites) -> None:
    errors = [place_markers(sites, TARGETS, count, RULES).largest_tre_mm for count in (4, 6, 8)]
    assert errors[0] > errors[1] > errors[2]
    placed = place_markers(sites, TARGETS, 3, RULES)
    assert np.linalg.svd(placed.centers_mm - placed.centers_mm.mean(axis=0), compute_uv=False)[1] > 30.0


def test_the_centroid_comes_nearer_to_the_target_than_an_even_spread_s(sites: Sites) -> None:
    target = TARGETS[:1]
    placed = place_markers(sites, target, 6, RULES)
    allowed = allowed_sites(sites, RULES)
    even = even_layout(allowed, 6, np.random.default_rng(1))
    nearer = np.linalg.norm(placed.centers_mm.mean(axis=0) - target)
    assert nearer < np.linalg.norm(allowed.centers_mm(RULES.height_mm)[even].mean(axis=0) - target)


def test_no_single_move_helps_any_more(sites: Sites) -> None:
    placed = place_markers(sites, TARGETS, 5, RULES)
    centers = allowed_sites(sites, RULES).centers_mm(RULES.height_mm)
    for place in range(5):
        others = np.delete(placed.centers_mm, place, axis=0)
        far = np.linalg.norm(centers[:, None] - others, axis=-1).min(axis=1) >= RULES.least_apart_mm
        for site in np.flatnonzero(far)[::7]:
            moved = np.vstack([others, centers[site]])
            better = expected_tre_mm(moved, TARGETS, RULES).max() < placed.largest_tre_mm * (1 - 1e-6)
            assert not better or describe_layout(moved).refusal_probability() > 0.01


@few_or_all("cases", 4, 12)
def test_it_beats_even_and_random_spreads(sites: Sites, cases: int) -> None:
    generator = np.random.default_rng(4)
    even, random = [], []
    for _ in range(cases):
        targets = generator.uniform([-35, -44, -13], [35, 44, 44], (generator.integers(1, 5), 3))
        around = generator.uniform(0.0, 2.0 * np.pi)
        rules = replace(RULES, tracker=(float(np.cos(around)), float(np.sin(around)), 0.5))
        count = int(generator.integers(4, 9))
        placed = place_markers(sites, targets, count, rules)
        even.append(1.0 - placed.largest_tre_mm / placed.even_tre_mm)
        centers = allowed_sites(sites, rules).centers_mm(rules.height_mm)
        layouts = [scattered_layout(centers, count, rules.least_apart_mm, generator) for _ in range(10)]
        errors = [expected_tre_mm(centers[one], targets, rules).max() for one in layouts if one is not None]
        random.append(1.0 - placed.largest_tre_mm / np.mean(errors))
    assert min(even) > 0.1
    assert np.mean(even) > 0.25
    assert np.mean(random) > 0.3


def test_the_expected_error_is_met_through_correspondence_and_registration(sites: Sites) -> None:
    placed = place_markers(sites, TARGETS, 6, RULES)
    generator = np.random.default_rng(12)
    errors = np.array([one_case(placed.centers_mm, generator) for _ in range(150)])
    measured = np.sqrt((errors**2).sum(axis=-1).mean(axis=0))
    np.testing.assert_allclose(measured, placed.tre_rms_mm, rtol=0.15)


def one_case(markers: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Errors (T, 3) at the targets after a simulated scan, a simulated reading, pairing and registration."""
    from scipy.spatial.transform import Rotation

    turn, shift = Rotation.random(rng=generator).as_matrix(), generator.uniform(-300, 300, 3)
    ct = markers + RULES.sigma_ct_mm * generator.standard_normal(markers.shape)
    order = generator.permutation(len(markers))
    ots = (markers @ turn.T + shift)[order] + RULES.sigma_ots_mm * generator.standard_normal(markers.shape)
    pairing = match_points(ct, ots, sigma_ct_mm=RULES.sigma_ct_mm, sigma_ots_mm=RULES.sigma_ots_mm)
    assert pairing.status == "unique"
    assert (order[pairing.pairs[:, 1]] == pairing.pairs[:, 0]).all()
    found = register_points(ct[pairing.pairs[:, 0]], ots[pairing.pairs[:, 1]])
    mapped: FloatArray = TARGETS @ found.transform[:3, :3].T + found.transform[:3, 3] - (TARGETS @ turn.T + shift)
    return mapped


def test_rules_that_leave_no_place_are_refused(sites: Sites) -> None:
    with pytest.raises(RefusedError, match="no unambiguous layout"):
        place_markers(sites, TARGETS, 6, replace(RULES, least_apart_mm=150.0))


@pytest.mark.parametrize(("count", "targets"), [(2, TARGETS), (5, np.empty((0, 3)))])
def test_too_few_markers_or_targets_are_refused(sites: Sites, count: int, targets: FloatArray) -> None:
    with pytest.raises(InputError):
        place_markers(sites, targets, count, RULES)
