"""Slices that were computed obliquely from thick ones: their balls are fitted along the profile of these."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d, map_coordinates, rotate
from scipy.spatial.transform import Rotation

from phantoms.scene import Part, Scene
from phantoms.solids import ellipsoid, frame_along, sphere
from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.documents.fiducials import fiducials_document
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import FiducialFlag, Fiducials, common_diameter, localize
from ronnaplan.localization.fit.neighbourhood import axes_along, gather
from ronnaplan.localization.scanner.summed import Summed
from ronnaplan.report.contact import gathered
from ronnaplan.report.marker_part import marker_pictures
from ronnaplan.report.tables import resolution_line
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack

PLACES = [(-16.0, -6.3, -7.2), (16.4, -7.0, 5.1), (1.2, 9.5, -5.3), (0.3, -8.1, 9.2)]
AZIMUTHS_DEG = (0.0, 12.0, 186.0, 60.0, 95.0, 130.0, 300.0)
HEIGHTS_MM = (6.0, -6.0, 1.0, 3.0, -7.0, 5.0, 0.0)
ALONG = np.array([0.0, 0.0, 1.0])
"""The normal of the slices that were measured."""


def computed_along(volume: CTVolume, axes: FloatArray, step_mm: float) -> CTVolume:
    """The slices across the last of ``axes``, by straight lines between the voxels, without a stated thickness."""
    steps = np.stack(np.meshgrid(*[np.arange(-n, n + 1) * step_mm for n in (16, 20, 26)], indexing="ij"), axis=-1)
    places_mm = steps[..., ::-1] @ axes
    indices = np.moveaxis(volume.grid.indices(places_mm), -1, 0)
    values_hu = map_coordinates(volume.voxels_hu.astype(np.float32), indices, order=1, cval=-1024.0)
    grid = SliceGrid(places_mm[:, 0, 0], axes[1] * step_mm, axes[0] * step_mm)
    return replace(volume, voxels_hu=np.round(values_hu).astype(np.int16), grid=grid)


@pytest.fixture(scope="module")
def oblique() -> CTVolume:
    stack = small_stack(spacing_mm=3.0, thickness_mm=3.0, start_mm=-24, stop_mm=24)
    thick = scan(balls(PLACES), stack, noise_hu=8.0)
    axes = Rotation.from_rotvec([0.35, 0.25, 0.0]).apply(np.eye(3))
    return computed_along(thick, axes, 1.0)


@pytest.fixture(scope="module")
def found(oblique: CTVolume) -> Fiducials:
    return localize(oblique, diameter_mm=11.5, expected=4)


def test_balls_in_oblique_slices_computed_from_thick_ones_are_found_and_the_old_normal_with_them(
    found: Fiducials,
) -> None:
    errors_mm = np.array([np.linalg.norm(found.centers - place, axis=1).min() for place in PLACES])
    assert errors_mm.max() < 0.03
    assert found.profile_axis is not None
    assert np.degrees(np.arccos(found.profile_axis @ ALONG)) < 1.5  # the slices lie 25 degrees off
    assert VolumeFlag.REFORMATTED in found.volume_flags


def test_balls_on_skin_are_found_in_oblique_slices_computed_from_thick_ones() -> None:
    """Skin smeared along the old slices' normal makes their edges ragged, in the new slices and a little along it."""
    outward = np.array([0.344, -0.918, -0.197])
    outward /= np.linalg.norm(outward)
    along, middle = frame_along(outward)[0], -84.0 * outward
    rim = [80.0 * outward + s * along + t * np.cross(outward, along) for s, t in ((-8, -7), (9, -6), (0, 9))]
    places = [tuple(middle + 85.75 * one / np.linalg.norm(one)) for one in rim]
    scene = Scene((Part(sphere(tuple(middle), 160.0), "skin"),)) + balls(places)
    stack = small_stack(spacing_mm=3.0, thickness_mm=3.0, start_mm=-27, stop_mm=27)
    thick = scan(scene, stack, seed=5)
    found = localize(
        computed_along(thick, Rotation.from_rotvec([0.35, 0.25, 0.0]).apply(np.eye(3)), 1.0), diameter_mm=11.5
    )
    assert len(found) == 3
    assert max(np.linalg.norm(found.centers - place, axis=1).min() for place in places) < 0.05
    assert found.profile_axis == pytest.approx(ALONG, abs=0.03)


def test_they_tell_nothing_of_how_rays_were_summed(
    oblique: CTVolume, found: Fiducials, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert found.summed_first is None
    told = Summed(first=True, error=0.3)
    monkeypatch.setattr("ronnaplan.localization.scanwide.logarithm.summed_told", lambda _: told)
    misled = localize(oblique, diameter_mm=11.5)
    assert misled.summed_first is None
    assert np.abs(misled.centers - found.centers).max() < 0.004


def test_where_their_profile_lies_is_written_and_told(found: Fiducials) -> None:
    written = fiducials_document(found).resolution
    assert written is not None
    assert written.profile_axis == pytest.approx(tuple(ALONG), abs=0.03)
    assert "along (" in resolution_line(found)[0]


def test_what_their_model_leaves_over_is_drawn_along_the_profile(oblique: CTVolume, found: Fiducials) -> None:
    along_hu, across_hu = (
        np.median([np.std(rest) for _, pairs in gathered(oblique, one)[:4] for _, rest in pairs])
        for one in (found, replace(found, profile_axis=None))
    )
    assert along_hu < 0.85 * across_hu
    assert all(one.apart_mm < 0.01 for one in marker_pictures(oblique, fiducials_document(found)))


def test_their_size_is_found_without_being_told(oblique: CTVolume) -> None:
    assert common_diameter(oblique) == pytest.approx(11.5, abs=0.05)


def test_balls_in_slices_that_were_measured_are_fitted_across_them() -> None:
    tilted = scan(balls(PLACES), small_stack(spacing_mm=3.0, thickness_mm=3.0, tilt_deg=18.0), noise_hu=8.0)
    found = localize(tilted, diameter_mm=11.5, expected=4)
    assert found.profile_axis is None
    assert VolumeFlag.REFORMATTED not in found.volume_flags


@few_and_others("longer", [0.2], [0.15])
def test_eggs_that_lie_aslant_side_by_side_are_not_taken_for_balls_in_a_longer_profile(longer: float) -> None:
    lying = frame_along((0.5, 0.3, 0.8))
    eggs = [Part(ellipsoid(place, (3.0, 3.0, 3.0 * (1.0 + longer)), lying), "acrylic") for place in PLACES]
    found = localize(scan(Scene(tuple(eggs)), small_stack(spacing_mm=2.0, thickness_mm=2.0)), diameter_mm=6.0)
    assert found.profile_axis is None
    assert not [one for one in found if not one.flags]


def test_a_focal_spot_that_blurs_more_in_one_direction_is_no_slant() -> None:
    still = scan(balls(PLACES), small_stack(spacing_mm=1.5, thickness_mm=1.5), noise_hu=8.0)
    smeared = gaussian_filter1d(still.voxels_hu.astype(np.float32), 0.35 / 0.5, axis=2)
    found = localize(replace(still, voxels_hu=np.round(smeared).astype(np.int16)), diameter_mm=11.5, expected=4)
    assert found.profile_axis is None


def turned_while_it_looks(volume: CTVolume, by_deg: float) -> CTVolume:
    """The scan, each of whose views blurs along the turn by a standard deviation of ``by_deg``, about the middle."""
    steps = (-1.5, -0.5, 0.5, 1.5)
    turns = [
        rotate(volume.voxels_hu.astype(np.float32), step * by_deg / 1.12, (1, 2), reshape=False) for step in steps
    ]
    mean_hu: FloatArray = np.stack(turns).mean(axis=0)
    return replace(volume, voxels_hu=np.round(mean_hu).astype(np.int16))


def test_what_a_turning_gantry_blurs_is_no_slant_where_most_balls_lie_in_other_directions_from_its_axis() -> None:
    """Three of seven balls lie in about one direction from it, or opposite, and are blurred alike across that."""
    azimuths = np.radians(AZIMUTHS_DEG)
    places = [(20.0 * np.cos(a), 20.0 * np.sin(a), z) for a, z in zip(azimuths, HEIGHTS_MM, strict=True)]
    still = scan(balls(places, 8.0), small_stack(), blur_mm=0.3)
    found = localize(turned_while_it_looks(still, 1.2), diameter_mm=8.0, expected=len(places))
    assert found.profile_axis is None
    assert VolumeFlag.REFORMATTED not in found.volume_flags
    assert not [one for one in found if FiducialFlag.COVERED in one.flags]


def test_what_a_turning_gantry_blurs_is_no_slant_where_all_balls_lie_on_one_side_of_the_head() -> None:
    """On the forehead, 100 mm from the axis of a gantry that takes 360 views a turn, they are smeared sideways."""
    still = scan(balls(PLACES, 8.0), small_stack(), blur_mm=0.3)
    smeared = gaussian_filter1d(still.voxels_hu.astype(np.float32), 0.5 / 0.5, axis=2)
    found = localize(replace(still, voxels_hu=np.round(smeared).astype(np.int16)), diameter_mm=8.0, expected=4)
    assert found.profile_axis is None
    assert VolumeFlag.REFORMATTED not in found.volume_flags


def test_a_neighbourhood_along_other_axes_holds_the_same_voxels_in_slabs(oblique: CTVolume) -> None:
    center, axes = np.array([1.0, 2.0, 3.0]), axes_along(oblique.grid.axes, ALONG)
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert axes[2] == pytest.approx(ALONG)
    own, turned = gather(oblique, center, 6.0, oblique.grid.axes), gather(oblique, center, 6.0, axes)
    places = [np.lexsort((one.offsets_mm @ one.axes).round(6).T) for one in (own, turned)]
    assert (own.offsets_mm @ own.axes)[places[0]] == pytest.approx((turned.offsets_mm @ axes)[places[1]])
    assert np.array_equal(own.values_hu[places[0]], turned.values_hu[places[1]])
    assert (np.diff(turned.slices) >= 0).all()
    assert np.ptp(turned.offsets_mm[turned.slices == 0, 2]) <= 1.0
