"""Where a header puts slices or pixels elsewhere than they were, every ball is the same ellipsoid, and that is told."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import cylinder, ellipsoid
from ronnaplan.ct import CTVolume
from ronnaplan.documents.fiducials import fiducials_document
from ronnaplan.errors import RefusedError
from ronnaplan.localization import localize
from ronnaplan.localization.examine import examine
from ronnaplan.localization.localizer import require_count
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.stretched import markers_tell
from ronnaplan.localization.template import Template
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack

PLACES = [(-14.0, -13.6, 1.1), (13.7, -14.2, -2.8), (-13.9, 14.1, 0.3), (14.3, 13.8, 3.2)]
STACK = small_stack(stop_mm=26.0)


@pytest.fixture(scope="module")
def sound() -> CTVolume:
    """Four balls of 11.5 mm on posts, in slices of 1 mm and pixels of 0.5 mm."""
    posts = (Part(cylinder(place, (0, 0, -1), 15, 4), "acrylic", embedded=True) for place in PLACES)
    return scan(Scene((*balls(PLACES).parts, *posts)), STACK)


def as_said(
    volume: CTVolume, *, slices: float = 1.0, rows: float = 1.0, columns: float = 1.0, sheared_deg: float = 0.0
) -> CTVolume:
    """The scan with a header whose distances are wrong by these factors, and whose slices lie aside."""
    grid = volume.grid
    along_mm = (grid.slice_positions_mm - grid.slice_positions_mm[0])[:, np.newaxis]
    aside_mm = along_mm * np.tan(np.radians(sheared_deg)) * grid.axes[1]
    said = replace(
        grid,
        origins_mm=grid.origins_mm + (slices - 1.0) * along_mm * grid.normal + aside_mm,
        row_step_mm=rows * grid.row_step_mm,
        column_step_mm=columns * grid.column_step_mm,
    )
    return replace(volume, grid=said)


@few_and_others(
    ("wrong", "told"),
    [
        (
            {"slices": 1.25},
            "1.25 times as long along the slices' normal as across: the slices' distance in the header (1.25 mm) may "
            "be wrong (1?)",
        ),
        (
            {"rows": 1.2},
            "1.20 times as long down the columns as across: the rows' distance in the header (0.6 mm) may be wrong "
            "(0.5?)",
        ),
        (
            {"rows": 1.15, "columns": 1.15},
            "1.15 times as long within the slices as along their normal: the pixels' distance in the header (0.575 mm) "
            "may be wrong (0.5?)",
        ),
        (
            {"sheared_deg": 12.0},
            "sheared by 12 degrees from slice to slice, as where a gantry's tilt was lost",
        ),
    ],
    [
        (
            {"slices": 2.0},
            "2.00 times as long along the slices' normal as across: the slices' distance in the header (2 mm) may be "
            "wrong (1?)",
        ),
        (
            {"slices": 0.5},
            "0.50 times as long along the slices' normal as across: the slices' distance in the header (0.5 mm) may "
            "be wrong (1?)",
        ),
        (
            {"columns": 0.8},
            "0.80 times as long along the rows as across: the columns' distance in the header (0.4 mm) may be wrong "
            "(0.5?)",
        ),
        (
            {"slices": 1 / np.cos(np.radians(25.0)), "sheared_deg": -25.0},
            "sheared by 25 degrees from slice to slice, as where a gantry's tilt was lost",
        ),
    ],
)
def test_balls_that_a_wrong_header_makes_ellipsoids_of_tell_how_wrong_it_is(
    sound: CTVolume, wrong: dict[str, float], told: str
) -> None:
    found = localize(as_said(sound, **wrong), diameter_mm=11.5)
    assert len(found) < len(PLACES)
    assert found.distortion is not None
    count, _, rest = found.distortion.partition(" candidates are alike ellipsoids, ")
    assert 3 <= int(count) <= len(PLACES)
    assert near(rest) == near(told)


def test_distances_of_rows_and_columns_that_were_exchanged_are_told_as_such(sound: CTVolume) -> None:
    grid = sound.grid
    rows = np.arange(0.0, sound.voxels_hu.shape[1] - 1, 1.2)  # of 0.6 mm, by straight lines
    low, share = rows.astype(int), (rows % 1.0)[:, np.newaxis]
    between = (1.0 - share) * sound.voxels_hu[:, low] + share * sound.voxels_hu[:, low + 1]
    voxels_hu = between.astype(np.int16, order="C")
    exchanged = replace(grid, row_step_mm=0.5 * grid.axes[1], column_step_mm=0.6 * grid.axes[0])
    found = localize(replace(sound, voxels_hu=voxels_hu, grid=exchanged), diameter_mm=11.5)
    assert not len(found)
    assert found.distortion == (
        "4 candidates are alike ellipsoids, 1.44 times as long along the rows as down the columns: the distances of "
        "rows and columns in the header (0.5 and 0.6 mm) may be exchanged"
    )


def test_where_a_tilted_gantrys_table_went_less_far_than_the_header_says() -> None:
    volume = scan(balls(PLACES), small_stack(tilt_deg=15.0, stop_mm=26.0))
    grid = volume.grid
    said = replace(grid, origins_mm=grid.origins_mm[0] + 1.25 * (grid.origins_mm - grid.origins_mm[0]))
    found = localize(replace(volume, grid=said), diameter_mm=11.5)
    assert not len(found)
    assert found.distortion is not None
    assert re.search(r"1\.2[456] times as long along the slices' normal", found.distortion)


def test_balls_about_an_insert_of_metal_tell_it_too() -> None:
    inserts = (Part(cylinder(place, (0, 0, -1), 4.5, 5), "steel", embedded=True) for place in PLACES)
    volume = as_said(scan(Scene((*balls(PLACES).parts, *inserts)), STACK), columns=1.2)
    found = localize(volume, diameter_mm=11.5)
    assert found.distortion is not None
    assert re.search(r"1\.(19|2|21)0? times as long along the rows", found.distortion)


def near(told: str) -> list[str]:
    """The words of a sentence, its numbers rounded as coarsely as they are measured."""
    words = told.replace("(", "( ").replace("?", " ?").split()
    return [f"{float(word):.1g}" if word[0].isdigit() else word for word in words]


def test_where_all_balls_are_found_with_another_size_that_is_not_proposed(sound: CTVolume) -> None:
    found = localize(as_said(sound, slices=1.08), diameter_mm=11.5)
    assert len(found) == len(PLACES)
    assert found.distortion is not None
    assert re.search(r"1\.0[78] times as long along the slices' normal", found.distortion)
    assert found.distortion in repr(found)


@few_and_others(
    ("wrong", "factor", "told"),
    [
        (
            {"slices": 1.02},
            1.02,
            "times as long along the slices' normal as across: the slices' distance in the header (1.02 mm) may be "
            "wrong (1?)",
        ),
        ({"sheared_deg": 1.0}, 1.0, "degrees from slice to slice, as where a gantry's tilt was lost"),
    ],
    [
        (
            {"rows": 0.99},
            0.99,
            "times as long down the columns as across: the rows' distance in the header (0.495 mm) may be wrong (0.5?)",
        ),
        (
            {"rows": 1.03, "columns": 1.03},
            1.03,
            "times as long within the slices as along their normal: the pixels' distance in the header (0.515 mm) may "
            "be wrong (0.5?)",
        ),
    ],
)
def test_markers_tell_what_is_wrong_by_a_few_percent(
    sound: CTVolume, wrong: dict[str, float], factor: float, told: str
) -> None:
    found = localize(as_said(sound, **wrong), diameter_mm=11.5)
    assert len(found) == len(PLACES)
    said = re.fullmatch(
        r"4 markers are alike ellipsoids \(standard error (0\.\d+)%\), (?:sheared by )?([\d.]+) (.*)",
        str(found.distortion),
    )
    assert said is not None
    assert float(said[1]) <= 0.4
    assert float(said[2]) == pytest.approx(factor, abs=0.003)
    assert said[3] == told
    assert f"the scan: {found.distortion}" in fiducials_document(found).source.doubts


def test_markers_in_thick_slices_tell_nothing() -> None:
    thick = scan(balls(PLACES), small_stack(stop_mm=26.0, spacing_mm=4.0))
    found = localize(as_said(thick, columns=1.02), diameter_mm=11.5)
    assert len(found) == len(PLACES)
    assert found.distortion is None


def test_eggs_of_which_most_lie_alike_by_chance_tell_nothing(sound: CTVolume) -> None:
    egg = next(one for one in examine(Scan(sound), (11.5,)) if one.is_marker)
    along = [np.diag([1.0, 1.0, 1.04]), np.diag([0.98, 1.02, 1.04]), np.diag([1.02, 0.98, 1.04])]
    assert markers_tell(Scan(sound), [replace(egg, shape=along[0])] * 3) is not None
    assert markers_tell(Scan(sound), [replace(egg, shape=shape) for shape in along]) is None
    assert markers_tell(Scan(sound), [replace(egg, shape=along[0], is_covered=True)] * 3) is None


def test_shapes_whose_medians_are_no_ellipsoid_tell_nothing(sound: CTVolume) -> None:
    ball = next(one for one in examine(Scan(sound), (11.5,)) if one.is_marker)
    lean = [(0.6, 0.6, 0.0), (0.6, 0.0, -0.6), (0.0, 0.6, -0.6)]
    shapes = [np.array([[1.0, uv, uw], [uv, 1.0, vw], [uw, vw, 1.0]]) for uv, uw, vw in lean]
    assert np.linalg.det(np.median(shapes, axis=0)) < 0.0 < min(map(np.linalg.det, shapes))
    assert markers_tell(Scan(sound), [replace(ball, shape=shape) for shape in shapes]) is None


def test_nothing_is_told_of_a_sound_scan(sound: CTVolume) -> None:
    for diameter_mm in (8.0, 10.0, 11.5, 13.0):
        assert localize(sound, diameter_mm=diameter_mm).distortion is None


@few_and_others(
    "half_mm",
    [
        [(5.7, 5.7, 7.5), (5.7, 5.7, 9.0), (5.7, 5.7, 6.9), (7.5, 5.7, 5.7)],  # each another one
        [(5.7, 4.6, 7.0)] * 4,  # alike, but by no grid
    ],
    [
        [(4.0, 4.0, 5.0)] * 4,  # of another size
        [(5.1, 5.1, 6.4)] * 4,  # of nearly that size
    ],
)
def test_nor_of_ellipsoids_that_no_wrong_header_makes_of_balls(half_mm: list[tuple[float, float, float]]) -> None:
    eggs = zip(PLACES, half_mm, strict=True)
    volume = scan(Scene(tuple(Part(ellipsoid(place, half), "acrylic") for place, half in eggs)), STACK)
    found = localize(volume, diameter_mm=11.5)
    assert len(found) < 3
    assert found.distortion is None


def test_nor_of_two_that_are_alike() -> None:
    volume = as_said(scan(balls(PLACES[:2]), STACK), slices=1.25)
    assert localize(volume, diameter_mm=11.5).distortion is None


def test_nor_of_eggs_among_balls() -> None:
    eggs = tuple(Part(ellipsoid((*place[:2], place[2] + 24.0), (5.75, 5.75, 7.5)), "acrylic") for place in PLACES)
    volume = scan(Scene((*balls(PLACES).parts, *eggs)), small_stack(stop_mm=44.0))
    found = localize(volume, diameter_mm=11.5)
    assert len(found) == len(PLACES)
    assert found.distortion is None


def test_small_balls_of_metal_tell_nothing_of_how_wrong_a_header_is() -> None:
    volume = as_said(scan(balls(PLACES, 4.0, "titanium"), STACK), slices=1.6)
    assert localize(volume, diameter_mm=4.0).distortion is None


def test_refusals_and_the_document_say_it(sound: CTVolume) -> None:
    volume = as_said(sound, slices=1.25)
    found = localize(volume, diameter_mm=11.5)
    assert f"the scan: {found.distortion}" in fiducials_document(found).source.doubts
    with pytest.raises(RefusedError, match=r"alike ellipsoids, 1\.25 times") as refused:
        require_count(found, 4, volume)
    assert "no sphere" not in str(refused.value)
    distances = np.linalg.norm(np.array(PLACES)[:, np.newaxis] - np.array(PLACES), axis=-1)
    frame = Template("frame", ("A", "B", "C", "D"), distances, 0.5)
    with pytest.raises(RefusedError, match=r"alike ellipsoids, 1\.25 times"):
        localize(volume, diameter_mm=11.5, template=frame)
