"""What the flange carries and comes near the wrist is told, for nothing keeps it apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from ronnaplan.geometry import FloatArray
from ronnaplan.pose import transform_points
from ronnaplan.robot.arm.forward import link_frames
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.placement.near import nearest_mm, what_comes_near
from ronnaplan.robot.placement.placement import find_places
from ronnaplan.robot.placement.room import Capsule, Room, Tool
from ronnaplan.robot.placement.world import Machine, machine_of
from tests.robot.placement.cases import job, room
from tests.robot.placement.test_placement import WIDE

REFERENCE_DEG = np.array([0.0, -120.0, 120.0, 0.0, 60.0, 0.0])
BENT_DEG = np.array([0.0, -120.0, 120.0, 0.0, 118.0, 0.0])
NAMES = (*(one.name for one in kr6_r900().bodies), "cameras")


def carrying(*bodies: Capsule, **changes: object) -> Room:
    return room(tool=Tool((0.0, 0.0, 120.0), bodies=bodies), **changes)


BESIDE = carrying(Capsule("cameras", (0.0, -70.0, 20.0), (0.0, 70.0, 20.0), 35.0))


def told(*ways: tuple[str, FloatArray], there: Room = BESIDE) -> tuple[str, ...]:
    return what_comes_near(machine_of(kr6_r900(), there), ways, NAMES, 20.0)


def sampled_mm(machine: Machine, posture_deg: FloatArray) -> FloatArray:
    """Least distances (T, A) by places along the capsules, 1 mm or less apart."""
    frames = link_frames(kr6_r900(), np.radians(posture_deg)[None])[0]
    along = np.linspace(0.0, 1.0, 500)[:, None]
    lines = [
        transform_points(frames[link], row[:3] + along * (row[3:6] - row[:3]))
        for link, row in zip(machine.links, machine.bodies, strict=True)
    ]
    count, radii = machine.tool_from, machine.bodies[:, 6]
    return np.array(
        [
            [cdist(lines[k], lines[j]).min() - radii[k] - radii[j] for j in range(count)]
            for k in range(count, len(lines))
        ]
    )


@pytest.mark.parametrize("seed", range(5))
def test_how_near_they_come_is_that_of_places_along_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    machine = machine_of(kr6_r900(), room())
    posture_deg = rng.uniform(-110.0, 40.0, 6)
    assert nearest_mm(machine, posture_deg[None]) == pytest.approx(sampled_mm(machine, posture_deg), abs=0.01)


def test_cameras_that_a_bent_wrist_brings_to_the_forearm_are_told_once_and_where_they_are_nearest() -> None:
    less_deg = np.array([0.0, -120.0, 120.0, 0.0, 105.0, 0.0])
    machine = machine_of(kr6_r900(), BESIDE)
    overlap_mm = -sampled_mm(machine, BENT_DEG)[0, NAMES.index("forearm")]
    assert overlap_mm > 5.0
    (sentence,) = told(
        ("on the way of A", np.array([REFERENCE_DEG, less_deg])), ("on the way of B", BENT_DEG[None])
    )
    assert sentence == (
        f"cameras and forearm overlap by {overlap_mm:.0f} mm on the way of B, where nothing keeps them apart"
    )
    (sentence,) = told(("on the way of A", np.array([REFERENCE_DEG, less_deg])))
    assert "mm apart on the way of A" in sentence
    assert told(("on the way of A", REFERENCE_DEG[None])) == ()


def test_what_lies_between_two_postures_is_looked_at() -> None:
    machine, ends_deg = machine_of(kr6_r900(), BESIDE), np.array([BENT_DEG, BENT_DEG])
    ends_deg[:, 4] = -100.0, 118.0
    ends_deg[0, 5], ends_deg[1, 5] = 90.0, -90.0
    way_deg = np.linspace(ends_deg[0], ends_deg[1], 110)
    least_mm = np.min([sampled_mm(machine, one) for one in way_deg], axis=0)
    assert nearest_mm(machine, ends_deg) == pytest.approx(least_mm, abs=0.1)
    assert (least_mm < np.minimum(*(sampled_mm(machine, one) for one in ends_deg)) - 1.0).any()


def test_what_is_as_near_in_every_posture_is_how_the_tool_is_drawn_and_not_told() -> None:
    holder = carrying(Capsule("cameras", (0.0, 0.0, 0.0), (0.0, 0.0, 95.0), 25.0))
    apart_mm = [nearest_mm(machine_of(kr6_r900(), holder), one[None])[0] for one in (REFERENCE_DEG, BENT_DEG)]
    assert [one[NAMES.index("wrist")] for one in apart_mm] == pytest.approx([-45.0, -45.0], abs=20.0)
    assert not any("wrist" in sentence for sentence in told(("there", BENT_DEG[None]), there=holder))


@pytest.mark.parametrize(("seed", "is_near"), [(0, False), (3, True)])
def test_each_place_that_is_found_tells_it(seed: int, is_near: bool) -> None:
    given = job(seed, 1, 0, floor=WIDE)
    machine, places = machine_of(given.arm, given.room), find_places(given).places
    assert places
    for place in places:
        postures = np.concatenate(
            [*(one.angles_deg for one in place.served), *(np.array([one]) for _, one in place.route.corners)]
        )
        least_mm = np.min([sampled_mm(machine, one)[:, NAMES.index("forearm")] for one in postures])
        assert (least_mm < 20.0) == is_near
        assert any(" and forearm " in sentence for sentence in place.near) == is_near
