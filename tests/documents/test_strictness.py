"""Every field of every document is taken at its word: nothing passes for what it is not, nothing is passed over."""

from __future__ import annotations

import copy
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.documents.chain import read_chain, stereo_chain, tracked_chain
from ronnaplan.documents.fiducials import Source, fiducials_document, read_fiducials
from ronnaplan.documents.limits import read_limits
from ronnaplan.documents.placement import PlacementDocument, read_placement
from ronnaplan.documents.placement_made import placement_document
from ronnaplan.documents.plan import plan_document, read_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.documents.registration import read_registration
from ronnaplan.documents.registration_made import registration_document
from ronnaplan.documents.rig import read_rig, read_spheres, rig_document, spheres_document
from ronnaplan.documents.template import read_template
from ronnaplan.documents.tool import hand_eye_document, pivot_document, read_hand_eye, read_pivot
from ronnaplan.errors import InputError
from ronnaplan.geometry import Frame, Points
from ronnaplan.planner.storage import Look
from ronnaplan.pose import Pose
from ronnaplan.registration.marker_registration import register_markers
from ronnaplan.robot.arm.arm import HeldJoint
from ronnaplan.robot.arm.forward import forward
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.chain import OTS, TCP, Capture, M, R
from ronnaplan.robot.hand_eye_found import HandEye
from ronnaplan.robot.pivot import calibrate_pivot
from ronnaplan.robot.placement.placement import Place as RobotPlace
from ronnaplan.robot.placement.placement import Placement
from ronnaplan.robot.placement.route import Route
from ronnaplan.robot.placement.serving import Served
from ronnaplan.robot.stereo.calibration import StereoCalibration, TcpCalibration
from ronnaplan.robot.stereo.camera import RIG, Boards, Camera
from ronnaplan.robot.stereo.markers import register_robot_markers
from ronnaplan.robot.stereo.robot_markers import RobotMarkers
from ronnaplan.transforms import rigid
from ronnaplan.untrusted import parse_json
from tests import cases
from tests.documents.test_fiducials import FOUND
from tests.robot.placement.cases import room

Reader = Callable[[Path], object]
Place = tuple[Any, ...]


def placed() -> PlacementDocument:
    """Return a placement with every field in use; its numbers are of no room."""
    served = Served("LH", "trajectory", np.zeros((2, 6)), 20.0, 30.0, 40.0, 50.0)
    route = Route(("LH",), 90.0, ("LH",), ("F1",), np.zeros(6), ())
    place = RobotPlace(np.eye(4), (served,), route, 0.9, ("cameras and forearm touch",), None)
    plan = cases.plan()
    first = plan.trajectories[0]
    entry_mm = first.target_mm - 50.0 * forward(kr6_r900(), np.zeros(6))[:3, 2]  # the tool points to the target
    return placement_document(
        Placement(np.eye(4), (place,), ()),
        room(tool=replace(room().tool, x_axis=(0.0, 1.0, 0.0))),
        replace(kr6_r900(), held=(HeldJoint("A0", 0.1, 1, np.eye(4), kr6_r900()),)),
        fiducials_document(FOUND).source,
        replace(plan, trajectories=(replace(first, name="LH", entry_mm=entry_mm),)),
    )


def square() -> list[list[float]]:
    corners = np.array([[0, 0, 0], [60, 0, 0], [60, 80, 0], [0, 80, 20]])
    distances: list[list[float]] = np.linalg.norm(corners[:, None] - corners, axis=-1).tolist()
    return distances


@cache
def documents() -> dict[str, tuple[Any, Reader]]:
    """Return each kind of document with every field in use, and its reader."""
    plan = cases.plan()
    found = register_markers(cases.fiducials().points, cases.readings())
    texts = {
        "fiducials": (to_json(fiducials_document(FOUND)), read_fiducials),
        "registration": (
            to_json(registration_document(found, cases.fiducials().source, plan.points)),
            read_registration,
        ),
        "plan": (
            to_json(plan_document(plan.edit("left", notes="twice\nas far").edit("left", name="right").undo())),
            read_plan,
        ),
        "placement": (to_json(placed()), read_placement),
        "limits": (
            json.dumps(
                {
                    "format": "ronnaplan.limits",
                    "version": 1,
                    "longest_path_mm": 80,
                    "greatest_skull_angle_deg": 30.0,
                    "least_no_go_distance_mm": 2.0,
                    "least_probability": 0.95,
                    "tolerance_mm": 2,
                }
            ),
            read_limits,
        ),
        **robot_documents(),
        "template": (
            json.dumps(
                {
                    "format": "ronnaplan.template",
                    "version": 1,
                    "unit": "mm",
                    "name": "frame",
                    "labels": list("ABCD"),
                    "distances": square(),
                    "tolerance": 0.5,
                }
            ),
            read_template,
        ),
    }
    return {name: (json.loads(text), reader) for name, (text, reader) in texts.items()}


def robot_documents() -> dict[str, tuple[str, Reader]]:
    """Return the documents on the way to the robot; their numbers are of a made-up session."""
    rng = np.random.default_rng(1)
    spread = np.diag(np.repeat([1e-8, 1e-2], 3))

    def pose(to: Frame, of: Frame) -> Pose:
        turn = Rotation.random(rng=rng).as_matrix()
        return Pose(rigid(turn, rng.normal(size=3) * 100), spread, to, of)

    poses = np.tile(np.eye(4), (200, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (200, 3))).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(200, 3)) * 0.1 - poses[:, :3, :3] @ [10.0, 20, 150]
    hand_eye = HandEye(pose(M, TCP), pose(R, OTS), 0.05, 0.2, 0.2)
    camera = Camera(
        np.array([[2100.0, 0, 320], [0, 2100, 256], [0, 0, 1]]),
        np.full(5, 0.01),
        np.eye(4),
        (640, 512),
    )
    aside = replace(camera, rig_from_camera=rigid(np.eye(3), np.array([150.0, 0, 0])))
    places = np.tile(np.eye(4), (8, 1, 1))
    places[:, :3, :3] = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (8, 3))).as_matrix()
    places[:, :3, 3] = (-24.0, -18, 300)
    boards = Boards((9, 7), 6.0, places, 0.02, 0.01)
    tcp = TcpCalibration(pose(TCP, RIG), np.ones(3), 0.02, 0.01)
    robot = np.array([pose(R, TCP).matrix for _ in range(4)])
    found = RobotMarkers(tuple("1234"), rng.normal(size=(4, 3)) * 90, np.tile(1e-4 * np.eye(3), (4, 1, 1)), robot,
                         tcp.tcp_from_rig)  # fmt: skip
    ct = Points(
        found.positions_mm[::-1] + 5, np.tile(1e-4 * np.eye(3), (4, 1, 1)), tuple("ABCD"), Frame("CT", "1.2")
    )
    source = Source(frame_of_reference_uid="1.2", voxel_sha256="0" * 64)
    capture = Capture(pose(OTS, M), hand_eye.m_from_tcp, pose(R, TCP))
    tracked = tracked_chain(pose(OTS, ct.frame), capture, source, np.ones(3), ("a note",))
    stereo = stereo_chain(register_robot_markers(ct, found, sigma_ct_mm=0.1), source, np.ones(3))
    return {
        "pivot": (to_json(pivot_document(calibrate_pivot(poses), "tool", ("a note",))), read_pivot),
        "hand-eye": (to_json(hand_eye_document(hand_eye, "tool", 60, pivot=True)), read_hand_eye),
        "rig": (
            to_json(rig_document(StereoCalibration(camera, aside, 0.1, boards), tcp, 12, 11.5)),
            read_rig,
        ),
        "spheres": (to_json(spheres_document(found, 11.5)), read_spheres),
        "tracked chain": (to_json(tracked), read_chain),
        "stereo chain": (to_json(stereo), read_chain),
    }


KINDS = ("fiducials", "registration", "plan", "limits", "template", "pivot", "hand-eye", "rig", "spheres",
         "tracked chain", "stereo chain")  # fmt: skip
"""All documents but a placement, which has its own tests."""


def refused(reader: Reader, file: Path) -> bool:
    try:
        reader(file)
    except InputError:
        return True
    return False


def write(file: Path, text: str) -> None:
    """Write a new file: one that is written over is first brought to the disk, thousands of times here."""
    file.unlink(missing_ok=True)
    file.write_text(text)


def leaves(value: Any, place: Place = (), *, at_ends: bool = False) -> Iterator[tuple[Place, Any]]:
    """All that is no list and no object; ``at_ends``: of a list, whose entries are alike, in its first and its last."""
    items = list(value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ())
    for key, child in items[:1] + items[1:][-1:] if at_ends and isinstance(value, list) else items:
        yield from leaves(child, (*place, key), at_ends=at_ends)
    if not isinstance(value, dict | list):
        yield place, value


def changed(content: Any, place: Place, value: Any) -> str:
    parent = copied = copy.copy(content)
    for key in place[:-1]:
        parent[key] = copy.copy(parent[key])
        parent = parent[key]
    parent[place[-1]] = value
    return json.dumps(copied)


@pytest.mark.parametrize("name", KINDS)
def test_every_document_with_all_its_fields_is_read(name: str, tmp_path: Path) -> None:
    content, reader = documents()[name]
    (tmp_path / "d.json").write_text(json.dumps(content))
    reader(tmp_path / "d.json")


@pytest.mark.parametrize("name", KINDS)
def test_nothing_passes_for_a_number(name: str, tmp_path: Path) -> None:
    content, reader = documents()[name]
    file = tmp_path / "d.json"
    numbers = [(place, value) for place, value in leaves(content, at_ends=True) if type(value) in (int, float)]
    assert numbers
    for place, value in numbers:
        for bad in (str(value), True, [value], {"value": value}, 1e308, -1e308, int("9" * 400)):
            write(file, changed(content, place, bad))
            assert refused(reader, file), f"{place} was taken as {bad!r}"
    for text in ("NaN", "Infinity", "1e999", "0x10", "1_0", "01"):
        write(file, changed(content, numbers[-1][0], "here").replace('"here"', text))
        with pytest.raises(InputError, match="not a JSON document"):
            reader(file)


@pytest.mark.parametrize("name", KINDS)
def test_nothing_passes_for_a_text(name: str, tmp_path: Path) -> None:
    content, reader = documents()[name]
    file = tmp_path / "d.json"
    for place, value in leaves(content):
        if isinstance(value, str) and place[-1] != "notes":
            for bad in (5, True, [value], f"{value}\u2028", f"\x1b[31m{value}", f"{value}\u202e", "\ud800"):
                write(file, changed(content, place, bad))
                assert refused(reader, file), f"{place} was taken as {bad!r}"


@pytest.mark.parametrize("name", KINDS)
def test_no_field_is_unknown_or_stands_twice(name: str, tmp_path: Path) -> None:
    content, reader = documents()[name]
    file = tmp_path / "d.json"
    objects = {place[:-1] for place, _ in leaves(content) if isinstance(place[-1], str)}
    for place in objects:
        write(file, changed(content, (*place, "centre"), 1))
        with pytest.raises(InputError, match="centre: no field of this document"):
            reader(file)
        twice = changed(content, (*place, "twice"), 1).replace('"twice": 1', '"twice": 1, "twice": 2')
        write(file, twice)
        with pytest.raises(InputError, match="'twice' stands twice"):
            reader(file)


def test_a_member_that_stands_twice_among_many_is_told_at_once() -> None:
    names = [f"m{number}" for number in range(20_000)]
    content = ", ".join(f'"{name}": 1' for name in (*names, names[-1], names[-2])).encode()
    began = time.process_time()
    with pytest.raises(ValueError, match="'m19998' stands twice in one object"):
        parse_json(b"{" + content + b"}")
    assert time.process_time() - began < 1.0


@pytest.mark.parametrize(
    "time", [5, "5", "1700000000", "2026-01-31", "2026-01-31T12:00:00", "yesterday", "0001-01-01T00:00:00+05:00"]
)
def test_a_time_is_written_out_with_its_zone(time: object, tmp_path: Path) -> None:
    content, reader = documents()["plan"]
    (tmp_path / "d.json").write_text(changed(content, ("history", 0, "time"), time))
    with pytest.raises(InputError, match=r"history\.0\.time"):
        reader(tmp_path / "d.json")
    (tmp_path / "d.json").write_text(changed(content, ("history", 0, "time"), datetime.now(UTC).isoformat()))
    reader(tmp_path / "d.json")


ASYMMETRIC = [[1e-6, 9e-9, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-6]]
"""Off by less than numpy's usual absolute tolerance, yet by a hundredth of a correlation."""
BEYOND = [[1e-4, 2e-4, 0.0], [2e-4, 1e-4, 0.0], [0.0, 0.0, 1e-4]]
SINGULAR = [[1e-4, 1e-4, 0.0], [1e-4, 1e-4, 0.0], [0.0, 0.0, 1e-4]]
NEGATIVE = [[-1e-4, 0.0, 0.0], [0.0, 1e-4, 0.0], [0.0, 0.0, 1e-4]]


@pytest.mark.parametrize("matrix", [ASYMMETRIC, BEYOND, SINGULAR, NEGATIVE, np.zeros((3, 3)).tolist()])
@pytest.mark.parametrize(
    ("name", "place"),
    [("fiducials", ("fiducials", 0, "covariance")), ("registration", ("targets", 0, "covariance"))],
)
def test_a_covariance_that_is_none_is_refused(name: str, place: Place, matrix: object, tmp_path: Path) -> None:
    content, reader = documents()[name]
    (tmp_path / "d.json").write_text(changed(content, place, matrix))
    with pytest.raises(InputError, match="not symmetric and positive definite"):
        reader(tmp_path / "d.json")


def test_a_camera_without_a_focal_length_is_refused_by_its_name(tmp_path: Path) -> None:
    content, reader = documents()["rig"]
    (tmp_path / "d.json").write_text(changed(content, ("left", "matrix", 0, 0), 0))
    with pytest.raises(InputError, match=r"left: .*positive focal lengths"):
        reader(tmp_path / "d.json")


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("misfit", 1e18, r"fiducials\.0\.misfit: Input should be .*, found 1e\+18"),
        ("label", None, r"fiducials\.0\.label: Input should be a valid string, found null"),
        ("misfit", "Doe^John", r"fiducials\.0\.misfit: Input should be a valid number; "),  # may be anybody's name
    ],
)
def test_a_refusal_says_what_number_was_found(field: str, value: object, told: str, tmp_path: Path) -> None:
    document = json.loads(to_json(fiducials_document(FOUND)))
    document["fiducials"][0][field] = value
    path = tmp_path / "fiducials.json"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=told):
        read_fiducials(path)


def test_a_marker_known_exactly_and_a_blank_name_are_refused(tmp_path: Path) -> None:
    content, reader = documents()["fiducials"]
    exact = (1e-300 * np.eye(3)).tolist()
    for place, value in ((("fiducials", 0, "covariance"), exact), (("fiducials", 0, "label"), " ")):
        (tmp_path / "d.json").write_text(changed(content, place, value))
        with pytest.raises(InputError, match=f"fiducials.0.{place[-1]}"):
            reader(tmp_path / "d.json")


def test_an_expected_error_is_that_of_its_covariance(tmp_path: Path) -> None:
    content, reader = documents()["registration"]
    stated = content["targets"][0]["predicted_tre_rms"]
    (tmp_path / "d.json").write_text(changed(content, ("targets", 0, "predicted_tre_rms"), stated / 2))
    with pytest.raises(InputError, match="its covariance says"):
        reader(tmp_path / "d.json")


def test_what_could_not_be_read_back_is_not_written() -> None:
    document = cases.fiducials()
    odd = document.fiducials[0].model_copy(update={"label": "F\u20281"})
    with pytest.raises(InputError, match=r"fiducials\.0\.label"):
        to_json(document.model_copy(update={"fiducials": (odd, *document.fiducials[1:])}))
    with pytest.raises(InputError, match=r"trajectories\.0\.name"):
        plan_document(cases.plan().edit("left", name="a\x1b[2J"))


def test_where_a_person_looked_is_read_as_strictly() -> None:
    assert not {
        name for name, field in Look.model_fields.items() if field.annotation is float and not field.metadata
    }


@pytest.mark.parametrize(
    ("i", "j", "distance", "says"),
    [(0, 1, 300.0, "no points in space"), (0, 2, 0.0, "same place"), (2, 3, 20.0, "no points in space")],
)
def test_distances_of_no_points_are_no_template(
    i: int, j: int, distance: float, says: str, tmp_path: Path
) -> None:
    content, reader = copy.deepcopy(documents()["template"])
    content["distances"][i][j] = content["distances"][j][i] = distance
    (tmp_path / "d.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=says):
        reader(tmp_path / "d.json")


def test_a_template_may_miss_space_by_its_tolerance(tmp_path: Path) -> None:
    content, reader = copy.deepcopy(documents()["template"])
    rng = np.random.default_rng(17)
    for i in range(4):
        for j in range(i):
            content["distances"][i][j] += rng.uniform(-0.5, 0.5)
            content["distances"][j][i] = content["distances"][i][j]
    (tmp_path / "d.json").write_text(json.dumps(content))
    reader(tmp_path / "d.json")
