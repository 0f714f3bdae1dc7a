"""The surfaces of the 3-D view lie where the scan has them, smooth, whole and without crumbs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan import extras
from ronnaplan.errors import InputError
from ronnaplan.scene import vtk
from ronnaplan.scene.field import Field, of_mask
from ronnaplan.scene.head import head_parts
from ronnaplan.scene.surfaces import REGION, SURFACES, Level, surfaces
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack

HALF_WAY = {"ball": Level(-440.0)}
CENTER = np.array([2.0, -3.0, 1.0])


@few_and_others("tilt_deg", [15.0], [0.0])
def test_the_surface_of_a_ball_lies_at_its_radius_and_its_normals_point_outwards(
    workshop: vtk.Workshop, tilt_deg: float
) -> None:
    volume = scan(balls([tuple(CENTER)], 20.0), small_stack(tilt_deg=tilt_deg))
    ball = surfaces(workshop, Field.of(volume, 1.2), HALF_WAY)["ball"]
    assert len(ball.triangles) > 500
    offsets = ball.vertices_mm - CENTER
    radii = np.linalg.norm(offsets, axis=1)
    assert radii == pytest.approx(10.0, abs=0.5)
    assert radii.mean() == pytest.approx(10.0, abs=0.2)  # the blur draws a ball in
    cosines = np.einsum("ij,ij->i", offsets / radii[:, np.newaxis], ball.normals)
    assert cosines.min() > 0.95
    assert np.mean(np.degrees(np.arccos(np.clip(cosines, -1, 1)))) < 4.0  # no steps
    a, b, c = (ball.vertices_mm[ball.triangles[:, n]].astype(float) for n in range(3))
    assert np.einsum("ij,ij->", a - CENTER, np.cross(b - CENTER, c - CENTER)) / 6 == pytest.approx(
        4 / 3 * np.pi * 1e3, rel=0.06
    )


def test_crumbs_are_dropped_cavities_are_sealed_and_much_is_thinned_out(workshop: vtk.Workshop) -> None:
    values = np.full((40, 40, 40), -1024.0, dtype=np.float32)
    values[8:32, 8:32, 8:32] = 500.0
    values[16:24, 16:24, 16:24] = -1024.0
    values[2:4, 2:4, 2:4] = 500.0
    field = Field(values, np.zeros(3), 1.0)
    found = surfaces(workshop, field, {"open": Level(0.0), "sealed": Level(0.0, sealed=True)})
    for name, inmost in (("open", 4.0), ("sealed", 11.0)):
        reach = np.abs(found[name].vertices_mm - 19.5).max(axis=1)
        assert reach.min() == pytest.approx(inmost, abs=1.0), name
        assert reach.max() < 13.0, name
    few = surfaces(workshop, field, {"open": Level(0.0)}, most_triangles=1000)["open"]
    assert 500 < len(few.triangles) <= 1000 < len(found["open"].triangles)
    assert np.abs(few.vertices_mm - 19.5).max() == pytest.approx(12.0, abs=1.0)


def test_a_region_and_an_empty_scan(workshop: vtk.Workshop) -> None:
    volume = scan(balls([(300.0, 0.0, 0.0)]), small_stack())
    assert all(len(part.triangles) == 0 for part in surfaces(workshop, Field.of(volume), SURFACES).values())
    mask = np.zeros(volume.voxels_hu.shape, dtype=np.bool_)
    mask[10:30, 40:90, 30:80] = True
    region = surfaces(workshop, of_mask(volume, mask), {"region": REGION}, outside=0.0)["region"]
    corners = volume.grid.positions_mm(np.array([[9.5, 39.5, 29.5], [29.5, 89.5, 79.5]]))
    assert region.vertices_mm.min(axis=0) == pytest.approx(corners.min(axis=0), abs=0.8)
    assert region.vertices_mm.max(axis=0) == pytest.approx(corners.max(axis=0), abs=0.8)


def test_a_scan_of_air_says_that_nothing_is_seen() -> None:
    empty = scan(balls([(300.0, 0.0, 0.0)]), small_stack())
    assert "nothing in this scan is as dense as skin" in head_parts(vtk.Workshop(), empty, {}, 2000).wanting


def test_all_that_a_head_is_drawn_from_comes_of_one_process_that_was_begun_before(workshop: vtk.Workshop) -> None:
    volume = scan(balls([tuple(CENTER)], 20.0), small_stack())
    mask = np.zeros(volume.voxels_hu.shape, dtype=np.bool_)
    mask[10:30, 40:90, 30:80] = True
    parts = head_parts(vtk.Workshop(), volume, {"region": mask}, 2000)
    assert parts.wanting == ""
    assert parts.volume is not None
    assert parts.volume.values.max() > parts.volume.values.min()
    alone = surfaces(workshop, Field.of(volume), most_triangles=2000)
    for name, body in alone.items():
        np.testing.assert_allclose(parts.surfaces[name].vertices_mm, body.vertices_mm)
    assert len(parts.regions["region"].triangles) > 100
    assert "could not make head" in head_parts(vtk.Workshop(), replace(volume, grid=None), {}, 2000).wanting  # type: ignore[arg-type]


def test_what_is_missing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    with vtk.Workshop() as workshop:
        with monkeypatch.context() as without:
            without.setattr(extras, "find_spec", lambda _: None)
            with pytest.raises(InputError, match=r"install ronnaplan\[scene\]"):
                workshop.arrays("surfaces", {})
        for task in ("what nobody knows", "surfaces"):  # a process that has ended does no more
            with pytest.raises(vtk.NoGraphicsError, match=r"could not make what nobody knows .*KeyError"):
                workshop.arrays(task, {})
