"""Templates: layouts that cannot be confused, bodies that are closed, plates that follow a scalp, drawings."""

import io
import zipfile
from itertools import permutations
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ronnaplan.correspondence import describe_layout
from ronnaplan.correspondence.layout import mirror_distance
from ronnaplan.documents.solids import WRITERS
from ronnaplan.documents.template import TemplateDocument, printed_template_document
from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray, mutual_distances
from ronnaplan.localization.template import match_template
from ronnaplan.planning.sites import Sites
from ronnaplan.planning.template_drawing import drawing_file, template_drawing
from ronnaplan.planning.template_fit import ROOM_MM, bent_to_scalp
from ronnaplan.planning.template_layout import (
    GREATEST_REFUSAL,
    Bridge,
    TemplateLayout,
    design_template,
    random_holes,
    refusal_text,
    require_unmistakable,
)
from ronnaplan.planning.template_solid import _letters, label_place, outline, template_solid
from tests.localization.test_template import markers
from tests.long import few_and_others, few_or_all
from tests.names import ANY_NAME


@pytest.fixture(scope="module")
def four() -> TemplateLayout:
    return design_template(4, Bridge())


def rival_by_hand(points: FloatArray, goals: FloatArray) -> float:
    points, goals = points - points.mean(axis=0), goals - goals.mean(axis=0)
    orders = list(permutations(range(len(points))))[1:]
    return min(float(Rotation.align_vectors(goals[list(order)], points)[1]) for order in orders)


def test_rivals_are_those_of_a_search_through_all_orders(four: TemplateLayout) -> None:
    points = four.centers_mm
    assert describe_layout(points).rival_distance_mm == pytest.approx(rival_by_hand(points, points), rel=1e-6)
    mirrored = rival_by_hand(points, points * [1.0, -1.0, 1.0])
    assert mirror_distance(points) == pytest.approx(mirrored, rel=1e-6)
    assert four.rival_distance_mm == pytest.approx(min(rival_by_hand(points, points), mirrored), rel=1e-6)


@few_or_all("cases", 100, 300)
@few_and_others("markers", [3], [5])
def test_a_template_keeps_its_size_and_clearance_and_beats_every_random_one(markers: int, cases: int) -> None:
    bridge = Bridge(size_mm=(100.0, 70.0))
    found = design_template(markers, bridge)
    assert (np.abs(found.holes_mm) <= np.array([50.0, 35.0]) - bridge.pad_radius_mm).all()
    apart = np.linalg.norm(found.centers_mm[:, np.newaxis] - found.centers_mm, axis=-1)[
        np.triu_indices(markers, 1)
    ]
    assert apart.min() >= bridge.marker_diameter_mm + bridge.clearance_mm
    assert found.refusal_probability < GREATEST_REFUSAL
    rng = np.random.default_rng(4)
    others = [random_holes(markers, bridge, rng) for _ in range(cases)]
    worths = [TemplateLayout(bridge, holes).worth_mm for holes in others if holes is not None]
    assert found.worth_mm > max(worths)
    assert found.is_worth_more(max(worths))
    assert np.linalg.svd(found.centers_mm - found.centers_mm.mean(axis=0))[1][1] > 0.9 * found.worth_mm  # no line


def test_markers_that_hardly_fit_find_room_and_others_are_refused() -> None:
    """Six on a plate of 70 x 50 mm were said not to fit, as holes that are drawn all at once never kept apart."""
    bridge = Bridge(size_mm=(70.0, 50.0), marker_diameter_mm=8.0, clearance_mm=3.0)
    holes = random_holes(6, bridge, np.random.default_rng(0))
    assert holes is not None
    assert (np.abs(holes) <= bridge.reach_mm).all()
    flat, stand = (mutual_distances(one)[np.triu_indices(6, 1)] for one in (holes, bridge.centers_mm(holes)))
    assert flat.min() >= 2 * bridge.pad_radius_mm
    assert stand.min() >= 11.0
    with pytest.raises(
        InputError, match=r"6 markers do not fit on 45 x 40 mm with 6 mm between them, on pads of 18"
    ):
        design_template(6, Bridge(size_mm=(45.0, 40.0)))


def test_print_and_screws_count_as_errors() -> None:
    near = np.array([[-20.0, 0.0], [20.0, 0.0], [2.0, 20.0]])
    loose, tight = (TemplateLayout(Bridge(screw_play_mm=play), near) for play in (2.0, 0.1))
    assert tight.refusal_probability < loose.refusal_probability
    assert loose.bridge.distance_tolerance_mm > 2 * tight.bridge.distance_tolerance_mm
    with pytest.raises(RefusedError, match="would be refused for its nearest rival in"):
        require_unmistakable(loose)


def test_a_layout_whose_mirror_image_has_the_same_distances_is_refused() -> None:
    kite = TemplateLayout(Bridge(radius_mm=60.0), np.array([[-45.0, 0.0], [45.0, 0.0], [0.0, 30.0], [0.0, -15.0]]))
    assert kite.refusal_probability < GREATEST_REFUSAL  # it cannot be turned so, but distances do not tell
    assert not kite.is_worth_more(0.1)
    with pytest.raises(
        RefusedError, match=r"differ by no more than 0\.0 mm in another order, expected over 3\.9 mm"
    ):
        require_unmistakable(kite)


def test_a_template_as_printed_is_recognized_and_its_markers_are_labelled(four: TemplateLayout) -> None:
    rng = np.random.default_rng(7)
    template = document(four).template
    bounds = np.array([four.bridge.print_tolerance_mm, four.bridge.screw_play_mm]).reshape(2, 1, 1)
    for _ in range(200):
        play = (rng.uniform(-1, 1, (2, 4, 3)) * bounds).sum(axis=0)
        places = Rotation.random(rng=rng).apply(four.centers_mm + play + rng.normal(0, 0.15, (4, 3)))
        found = match_template(template, markers(places[rng.permutation(4)]))[0]
        assert [one.label for one in found] == list(four.labels)
        np.testing.assert_array_equal([one.center_mm for one in found], places)


def document(found: TemplateLayout) -> TemplateDocument:
    return TemplateDocument.model_validate_json(printed_template_document(found, "printed"))


@pytest.mark.parametrize("radius_mm", [None, 70.0])
@pytest.mark.parametrize("kind", [".stl", ".3mf"])
def test_the_body_is_closed_and_has_a_hole_for_every_screw(radius_mm: float | None, kind: str) -> None:
    bridge = Bridge(radius_mm=radius_mm)
    found = TemplateLayout(bridge, np.array([[-45.0, -25.0], [-20.0, 28.0], [50.0, 10.0]]))
    body = read_body(WRITERS[kind](template_solid(found), "template"), kind)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.body_count == 1
    assert body.euler_number == 2 - 2 * (3 + 1)  # three screws, and the opening between three bars
    thickness = bridge.thickness_mm
    if radius_mm is None:
        areas = [shoelace_mm2(ring) for ring in outline(found)]
        assert 3 * 3.0 < sum(areas) * thickness - body.volume < 3 * 20.0  # three letters, 0.8 mm deep
    corners = np.asarray(body.triangles)
    for hole in found.holes_mm:
        assert turns_about(bridge.bent(np.array([*hole, thickness / 2])), corners) == pytest.approx(0, abs=1e-6)
        wall = bridge.bent(np.array([hole[0], hole[1] + 4.0, thickness / 2]))
        assert turns_about(wall, corners) == pytest.approx(1, abs=1e-6)


def shoelace_mm2(ring: FloatArray) -> float:
    following = np.roll(ring, -1, axis=0)
    return float((ring[:, 0] * following[:, 1] - ring[:, 1] * following[:, 0]).sum() / 2)


def read_body(content: bytes, kind: str) -> Any:
    import trimesh  # takes a third of a second, and no other test needs it

    if kind == ".stl":
        return trimesh.load_mesh(io.BytesIO(content), file_type="stl")
    space = {"m": "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"}
    model = ElementTree.fromstring(zipfile.ZipFile(io.BytesIO(content)).read("3D/3dmodel.model"))
    assert model.get("unit") == "millimeter"
    vertices = [[float(one.attrib[axis]) for axis in "xyz"] for one in model.iterfind(".//m:vertex", space)]
    faces = [[int(one.attrib[f"v{n}"]) for n in (1, 2, 3)] for one in model.iterfind(".//m:triangle", space)]
    return trimesh.Trimesh(vertices, faces, process=False)


def turns_about(place: FloatArray, corners: FloatArray) -> float:
    """How often a surface of triangles (T, 3, 3) goes about a place: 1 inside (van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(corners - place, 1, 0)
    la, lb, lc = (np.linalg.norm(one, axis=1) for one in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=1)
    scale = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return float(2 * np.arctan2(volume, scale).sum() / (4 * np.pi))


def test_bending_keeps_lengths_along_the_lower_surface_and_heights() -> None:
    bridge = Bridge(radius_mm=80.0)
    way = np.stack([np.linspace(-50, 50, 2001), np.zeros(2001), np.zeros(2001)], axis=1)
    bent = bridge.bent(way)
    assert np.linalg.norm(np.diff(bent, axis=0), axis=1).sum() == pytest.approx(100.0, abs=1e-3)
    raised = bridge.bent(way + np.array([0, 0, 7.0]))
    np.testing.assert_allclose(raised - bent, 7.0 * (bent + np.array([0, 0, 80.0])) / 80.0, atol=1e-9)


@pytest.mark.parametrize("radius_mm", [None, 60.0])
def test_holes_are_as_wide_through_the_whole_plate_and_square_to_it(radius_mm: float | None) -> None:
    """Drilled before it was bent, a hole of 4 mm was 4.8 mm wide at the upper surface, so that its screw had play."""
    import manifold3d

    bridge = Bridge(radius_mm=radius_mm, thickness_mm=12.0, hole_diameter_mm=4.0)
    holes = np.array([[-50.0, 20.0], [45.0, 25.0], [0.0, -30.0]])
    solid = template_solid(TemplateLayout(bridge, holes))
    surface = np.array(solid.vertices_mm), np.array(solid.triangles, dtype=np.uint64)  # copies that may be written
    body = manifold3d.Manifold(manifold3d.Mesh64(*surface))
    for x, y in holes:
        tilt_deg = 0.0 if radius_mm is None else np.degrees(x / radius_mm)
        place = bridge.bent(np.array([x, y, 0.0])).tolist()
        inner, outer = (
            manifold3d.Manifold.cylinder(10.0, radius, radius, 64)
            .translate((0.0, 0.0, 1.0))  # to beneath the letters
            .rotate((0.0, tilt_deg, 0.0))
            .translate(place)
            for radius in (2.0, 2.2)
        )
        assert (body ^ inner).volume() < 0.01
        assert (body ^ outer).volume() == pytest.approx((outer - inner).volume(), rel=1e-3)


@pytest.mark.parametrize("hole_mm", [2.4, 6.0, 8.9])
def test_no_hole_takes_the_foot_of_a_letter(hole_mm: float) -> None:
    """An E without it is an F: of no letter more than a tenth is lost to its hole."""
    import manifold3d

    holes = np.array([[-40.0, 25.0], [40.0, 20.0], [-30.0, -25.0], [25.0, -25.0], [0.0, 0.0]])
    found = TemplateLayout(Bridge(hole_diameter_mm=hole_mm), holes)
    for label, place in zip(found.labels, holes, strict=True):
        letter = manifold3d.CrossSection(_letters(label), manifold3d.FillRule.EvenOdd)
        letter = letter.translate(label_place(found, place).tolist())
        hole = manifold3d.CrossSection.circle(hole_mm / 2, 64).translate(place.tolist())
        assert (letter ^ hole).area() < 0.1 * letter.area()


@pytest.mark.parametrize(
    ("axes_mm", "size_mm", "at_mm"),
    [
        ((75.0, 95.0, 85.0), (100.0, 60.0), None),
        ((45.0, 55.0, 50.0), (78.0, 52.0), None),  # an infant's
        ((76.0, 95.0, 85.0), (120.0, 80.0), (54.0, 0.0, 60.0)),  # halfway to the ear
    ],
)
def test_a_plate_follows_a_scalp_and_is_as_near_as_is_told(
    axes_mm: tuple[float, ...], size_mm: tuple[float, float], at_mm: tuple[float, ...] | None
) -> None:
    """Both figures of the gap are those across the plate, not along its middle's axis."""
    axes = np.array(axes_mm)
    directions = np.random.default_rng(1).normal(size=(12_000, 3))
    directions = directions[directions[:, 2] > -0.5]
    scalp = directions / np.linalg.norm(directions / axes, axis=1, keepdims=True)
    normals = scalp / axes**2
    sites = Sites(scalp, normals / np.linalg.norm(normals, axis=1, keepdims=True), np.zeros(3))
    fitted = bent_to_scalp(Bridge(size_mm=size_mm), sites, None if at_mm is None else np.array(at_mm))
    sides = (np.linspace(-side / 2, side / 2, 41) for side in size_mm)
    across, depth = np.meshgrid(*sides)
    under = fitted.bridge.bent(np.stack([across, depth, 0 * across], axis=-1)).reshape(-1, 3)
    lps = under @ fitted.lps_from_template[:3, :3].T + fitted.lps_from_template[:3, 3]
    assert np.linalg.norm(lps / axes, axis=1).min() > 1.0
    gaps = np.asarray(cKDTree(scalp).query(lps)[0])
    assert gaps.min() == pytest.approx(ROOM_MM, abs=0.3)
    assert gaps.max() == pytest.approx(fitted.widest_gap_mm, rel=0.15)
    assert np.linalg.det(fitted.lps_from_template[:3, :3]) == pytest.approx(1.0)


def round_head(radius_mm: float) -> Sites:
    normals = np.random.default_rng(1).normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Sites(radius_mm * normals, normals, np.zeros(3))


@pytest.mark.parametrize("width_mm", [180.0, 210.0])
def test_a_plate_that_is_bent_most_to_a_small_head_is_one_that_can_be_made(width_mm: float) -> None:
    """Half of some widths is not the reciprocal of its own reciprocal."""
    fitted = bent_to_scalp(Bridge(size_mm=(width_mm, 80.0), radius_mm=None), round_head(50.0))
    assert fitted.bridge.radius_mm == width_mm / 2
    fitted.bridge.check()


def test_places_off_the_scalp_or_on_the_face_are_refused() -> None:
    sites = round_head(90.0)
    with pytest.raises(InputError, match="off the scalp"):
        bent_to_scalp(Bridge(), sites, np.array([0.0, 0.0, 150.0]))
    with pytest.raises(RefusedError, match="faces the front or the back"):
        bent_to_scalp(Bridge(), sites, np.array([0.0, -90.0, 0.0]))


@pytest.mark.parametrize(
    ("bridge", "sentence"),
    [
        (Bridge(size_mm=(15.0, 80.0)), "no room for a pad"),
        (Bridge(radius_mm=50.0), "at least half its width"),
        (Bridge(marker_height_mm=3.0), "at least their radius"),
        (Bridge(size_mm=(30.0, 22.0)), "do not fit"),
        (Bridge(hole_diameter_mm=0.0), "holes of 0 mm"),
        (Bridge(thickness_mm=0.0), "0 mm thick was asked for; expected more than 0.8 mm"),
        (Bridge(marker_diameter_mm=0.0), "markers of 0 mm"),
        (Bridge(clearance_mm=-5.0), "-5 mm apart"),
        (Bridge(print_tolerance_mm=-1.0), "nothing below zero"),
        (Bridge(screw_play_mm=-1.0), "nothing below zero"),
        (Bridge(size_mm=(2000.0, 80.0), radius_mm=1000.0), "a length of 2000 mm, .* expected up to 500 mm"),
        (Bridge(marker_height_mm=1e6), "expected up to 500 mm"),
        (Bridge(radius_mm=1e17), "a radius of 1e\\+17 mm, was asked for"),
    ],
)
def test_plates_that_cannot_be_are_refused(bridge: Bridge, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        design_template(3, bridge)


def test_a_probability_is_told_in_percent() -> None:
    assert [refusal_text(one) for one in (1e-6, 0.00123, 0.998, 1.0)] == [
        "less than 0.001 %",
        "0.123 %",
        "99.8 %",
        "100 %",
    ]


@pytest.mark.parametrize("kind", ["svg", "pdf"])
def test_a_drawing_is_named_in_any_script_and_by_the_letter(four: TemplateLayout, kind: str) -> None:
    drawing_file(
        template_drawing(four, ANY_NAME), kind
    )  # a letter without a font is a warning, a bad formula an error


def test_the_drawing_is_to_scale_and_the_same_each_time(four: TemplateLayout) -> None:
    page = template_drawing(four, "t")
    width, height = page.get_size_inches() * 25.4
    assert (width, height) == pytest.approx((210.0, 297.0))
    axes = page.axes[0]
    mm = axes.transData.transform([[0, 0], [10, 0]])[:, 0] / page.dpi * 25.4
    assert mm[1] - mm[0] == pytest.approx(10.0, rel=1e-6)
    for kind, start in (("svg", b"<?xml"), ("pdf", b"%PDF")):
        first, second = (drawing_file(template_drawing(four, "t"), kind) for _ in range(2))
        assert first.startswith(start)
        assert first == second


@pytest.mark.parametrize(
    "bridge",
    [
        Bridge(),
        Bridge(marker_diameter_mm=60.0, marker_height_mm=30.0),
        Bridge(marker_height_mm=500.0),
        Bridge(size_mm=(500.0, 500.0), radius_mm=250.0, thickness_mm=500.0),
    ],
)
def test_all_lines_of_a_drawing_lie_in_their_pane(bridge: Bridge) -> None:
    reach = bridge.reach_mm
    found = TemplateLayout(bridge, np.array([[-reach[0], -reach[1]], [0.2 * reach[0], reach[1]], [reach[0], 0.0]]))
    pattern, front = template_drawing(found, "t").axes
    for axes in (pattern, front):
        drawn = np.concatenate([np.column_stack(line.get_data()) for line in axes.lines])
        assert (np.abs(drawn) <= [axes.get_xlim()[1], axes.get_ylim()[1]]).all()
    texts = [text for text in pattern.texts if text.get_text()]
    assert all(np.abs(text.get_position()).max() < pattern.get_xlim()[1] for text in texts)
