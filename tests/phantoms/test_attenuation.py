from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phantoms.attenuation import Matter
from phantoms.cone_rays import Panel, Views, cone_transmission
from phantoms.projection import Detector, transmission
from phantoms.rays import pack, unit_interval, visible_segments
from phantoms.solids import FloatArray, Solid, box, cone, cylinder, ellipsoid, half_space, sphere

TURN = Rotation.from_euler("xyz", [0.3, 0.5, 1.0]).as_matrix()
SOLIDS = [
    half_space((0, 70, 0), (0.1, -1, 0.2)),
    ellipsoid((1, -2, 0), (60, 50, 90), TURN),
    ellipsoid((4, -6, 3), (50, 45, 80), TURN),
    box((2, 0, 1), (14, 37, 29), Rotation.from_euler("xyz", [1.0, 0.2, 0.4]).as_matrix()),
    cone((0, 0, -5), (0.2, -0.1, 1), 22, 19, 6),
    sphere((40, 20, 2), 11.5),
    cylinder((38, 20, -4), (1, 2, 3), 19, 5),
    cylinder((-30, 5, -20), (0, 0, 1), 50, 12),
]
PER_MM = np.array([0.001, 0.02, 0.025, 0.04, 0.01, 0.024, 0.2, 0.03])
MATTER = Matter(np.arange(len(SOLIDS)), PER_MM[:, np.newaxis], np.ones(1), np.zeros(len(SOLIDS), np.bool_))
PLACE, AXES, ANGLE, REACH = np.array([3.0, -2.0, 1.5]), np.ascontiguousarray(TURN.T), 0.7, 120.0
ACROSS = np.cos(ANGLE) * AXES[0] + np.sin(ANGLE) * AXES[1]
ALONG = np.cos(ANGLE) * AXES[1] - np.sin(ANGLE) * AXES[0]


def depth(origin: FloatArray, direction: FloatArray, nearest: float, farthest: float) -> float:
    """Return what one ray loses, solid by solid."""
    starts, stops, owned = [], [], []
    for n, solid in enumerate(SOLIDS):
        affine = solid.unit_from_world
        o, d = affine[:, :3] @ origin + affine[:, 3], affine[:, :3] @ direction
        t0, t1 = unit_interval(int(solid.shape), o[0], o[1], o[2], d[0], d[1], d[2], solid.top_ratio)
        if min(t1, farthest) > max(t0, nearest):
            starts.append(max(t0, nearest))
            stops.append(min(t1, farthest))
            owned.append(n)
    edges, owners = np.empty(2 * len(owned)), np.empty(2 * len(owned), np.int64)
    count = visible_segments(np.array(starts), np.array(stops), len(owned), edges, owners)
    lengths = np.diff(edges[: count + 1]) * np.linalg.norm(direction)
    return float(sum(PER_MM[owned[o]] * length for o, length in zip(owners, lengths, strict=False) if o >= 0))


def test_rows_of_parallel_rays_lose_what_single_rays_do() -> None:
    columns, bin_mm = 151, 1.3
    signal = np.empty((1, 1, columns), np.float32)
    detector = Detector(bin_mm, 1e-7, 1, REACH)
    frames = (np.tile(PLACE, (1, 1, 1)), np.tile(AXES, (1, 1, 1, 1)), np.array([ANGLE]))
    transmission(pack(SOLIDS), MATTER, detector, *frames, signal)
    places = (np.arange(columns) - (columns - 1) / 2) * bin_mm
    limits = np.sqrt(REACH**2 - places**2)
    expected = [depth(PLACE + u * ACROSS, ALONG, -far, far) for u, far in zip(places, limits, strict=True)]
    assert -np.log(signal[0, 0]) == pytest.approx(expected, abs=1e-5)
    assert np.ptp(expected) > 2


def test_rows_of_a_fan_lose_what_single_rays_do() -> None:
    columns, bin_mm, row_mm, away = 151, 1.3, 4.2, 500.0
    signal = np.empty((1, 2, columns), np.float32)
    source = PLACE - away * ALONG
    views = Views(*(one[np.newaxis] for one in (source, PLACE, ACROSS, AXES[2])))
    first = -(columns - 1) / 2 * bin_mm
    cone_transmission(pack(SOLIDS), MATTER, Panel(bin_mm, row_mm, first, -2.0, 2, REACH), views, signal)
    for row, v in enumerate((-2.0, 2.2)):
        targets = PLACE + (first + np.arange(columns) * bin_mm)[:, np.newaxis] * ACROSS + v * AXES[2]
        expected = [depth(source, target - source, 1 - REACH / away, 1 + REACH / away) for target in targets]
        assert -np.log(signal[0, row]) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("fine", [False, True], ids=["an edge", "looked at closely"])
def test_where_it_matters_an_element_is_seen_by_more_rays(fine: bool) -> None:
    """An element half in the shadow of a small ball reads the mean of what arrives, not of one ray."""
    ball: list[Solid] = [sphere((0, 0, 0), 6)]
    matter = Matter(np.zeros(1, np.int64), np.full((1, 1), 0.3), np.ones(1), np.array([fine]))
    frames = (np.zeros((1, 1, 3)), np.eye(3)[np.newaxis, np.newaxis], np.zeros(1))
    seen = {rays: np.empty((1, 1, 9), np.float32) for rays in (1, 8)}
    for rays, signal in seen.items():
        transmission(pack(ball), matter, Detector(2.0, 0.1, rays, REACH), *frames, signal)
    within = np.linspace(1, 3, 4001)
    assert seen[1][0, 0, 5] == pytest.approx(np.exp(-0.6 * np.sqrt(5)), abs=1e-3)
    assert seen[8][0, 0, 5] == pytest.approx(np.exp(-0.6 * np.sqrt(9 - within**2)).mean(), abs=5e-3)
    assert abs(seen[8][0, 0, 5] - seen[1][0, 0, 5]) > 0.02
