"""Whether rays were summed before the logarithm: the poles of balls in thick slices tell, and it is made good."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.documents.fiducials import fiducials_document
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import Build, Fiducials, localize
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.examine import examine_place
from ronnaplan.localization.fit.residuals import residuals_and_jacobian
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide import logarithm
from ronnaplan.localization.scanwide.logarithm import summed_told, told_by
from ronnaplan.localization.search.detect import detect
from ronnaplan.report.marker_part import marker_pictures
from ronnaplan.report.tables import resolution_line
from tests.localization.scanner.test_summed import WIDTH_MM, summed_picture_hu
from tests.scans import balls, offsets_mm, scan, small_stack

DIAMETER_MM, BLUR_MM = 12.0, 0.6
PLACES = [(-16.0, -6.3, -7.2), (16.4, -7.0, 5.9), (1.2, 9.5, -5.3), (0.3, -8.1, 9.2)]


def darkened(volume: CTVolume) -> CTVolume:
    """The scan as a detector as tall as a slice would have made it: each ball by back-projection."""
    lost_hu = np.zeros(volume.voxels_hu.shape)
    for place in PLACES:
        u, v, w = offsets_mm(volume, np.array(place))
        for number, height_mm in enumerate(w[:, 0, 0]):
            if abs(height_mm) < (DIAMETER_MM + WIDTH_MM) / 2:
                picture_hu = summed_picture_hu(height_mm, 0.0)
                middle = len(picture_hu) // 2
                radii_mm = 0.25 * np.arange(middle + 1)
                lost_hu[number] += np.interp(np.hypot(u, v)[number], radii_mm, picture_hu[middle, middle:])
    return replace(volume, voxels_hu=np.round(volume.voxels_hu - lost_hu).astype(np.int16))


def errors_mm(found: Fiducials) -> FloatArray:
    return np.array([np.linalg.norm(found.centers - place, axis=1).min() for place in PLACES])


@pytest.fixture(scope="module")
def after() -> CTVolume:
    """The logarithm was taken first."""
    stack = small_stack(spacing_mm=WIDTH_MM, thickness_mm=WIDTH_MM, start_mm=-24, stop_mm=24)
    return scan(balls(PLACES, DIAMETER_MM), stack, blur_mm=BLUR_MM, noise_hu=4.0)


@pytest.fixture(scope="module")
def before(after: CTVolume) -> CTVolume:
    """The rays were summed first."""
    return darkened(after)


@pytest.fixture(scope="module")
def found(before: CTVolume) -> Fiducials:
    return localize(before, diameter_mm=DIAMETER_MM, expected=len(PLACES))


def test_balls_whose_rays_were_summed_first_are_where_they_would_be_otherwise(
    before: CTVolume, found: Fiducials, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert found.summed_first
    monkeypatch.setattr("ronnaplan.localization.scanwide.logarithm.ASKED", 0)  # nobody is asked
    as_it_is = localize(before, diameter_mm=DIAMETER_MM)
    assert as_it_is.summed_first is None
    assert errors_mm(as_it_is).max() > 0.015
    assert errors_mm(found).max() < 0.4 * errors_mm(as_it_is).max()


def test_balls_whose_logarithm_was_taken_first_say_so_and_are_surer_for_it(
    after: CTVolume, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = localize(after, diameter_mm=DIAMETER_MM, expected=len(PLACES))
    assert found.summed_first is False
    monkeypatch.setattr("ronnaplan.localization.scanwide.logarithm.ASKED", 0)
    nobody_asked = localize(after, diameter_mm=DIAMETER_MM)
    assert (found.centers == nobody_asked.centers).all()
    more_mm2 = np.array([b.covariance_mm2 - a.covariance_mm2 for a, b in zip(found, nobody_asked, strict=True)])
    assert np.sqrt(more_mm2[:, 2, 2]).min() > 0.004  # 3 mm: half of 0.009 mm
    assert np.abs(more_mm2[:, :2, :2]).max() < 1e-9


def test_the_document_the_table_and_the_report_say_that_it_was_made_good(
    before: CTVolume, found: Fiducials
) -> None:
    document = fiducials_document(found)
    assert document.resolution is not None
    assert document.resolution.summed_first
    assert "rays summed before the logarithm, which is made good" in resolution_line(found)[0]
    assert max(picture.apart_mm for picture in marker_pictures(before, document)) < 0.005


def test_what_was_made_good_is_fitted_where_candidates_were_seen_before(
    before: CTVolume, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched = []

    def counted(volume: CTVolume, diameter_mm: float) -> FloatArray:
        searched.append(diameter_mm)
        return detect(volume, diameter_mm)

    monkeypatch.setattr("ronnaplan.localization.examine.detect", counted)
    assert localize(before, diameter_mm=DIAMETER_MM).summed_first
    assert searched == [DIAMETER_MM]


def test_hollow_markers_and_too_few_tell_nothing(before: CTVolume) -> None:
    assert localize(before, diameter_mm=DIAMETER_MM, marker=Build.parse("wrapped:2")).summed_first is None
    assert summed_told([(1.0, 1.0), None, (1.0, 1.0)]) is None


@pytest.mark.parametrize(
    ("told", "is_first"),
    [
        ([(90.0, 100.0), (110.0, 100.0), (105.0, 100.0), (-3e4, 1e4)], True),  # one is led astray, loudly
        ([(5.0, 100.0), (-7.0, 100.0), (15.0, 100.0)], False),
        ([(-20.0, 10.0), (5.0, 10.0), (30.0, 10.0), (15.0, 10.0)], None),  # they do not agree
        ([(60.0, 100.0), (60.0, 100.0), (60.0, 100.0)], None),  # neither the one nor the other
        ([(27.1, 37.0), (32.4, 40.0), (-63.5, 144.5)], None),  # three in noise that happen to agree
    ],
)
def test_most_of_the_balls_decide(told: list[tuple[float, float]], is_first: bool | None) -> None:
    summed = summed_told(told)
    assert (None if summed is None else summed.first) is is_first


def test_a_fit_that_leaves_nothing_over_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    thick = Scan(scan(balls([(1.0, 2.0, 3.0)]), small_stack(spacing_mm=2.0, thickness_mm=2.0)))
    one = examine_place(thick, np.array([1.0, 2.0, 3.0]), 11.5, SOLID)
    assert told_by(thick, one) is not None
    real = residuals_and_jacobian
    monkeypatch.setattr(
        logarithm, "residuals_and_jacobian", lambda *given: (0.0 * real(*given)[0], real(*given)[1])
    )
    assert told_by(thick, one) is None


def test_a_ball_of_which_summing_takes_nothing_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    thick = Scan(scan(balls([(1.0, 2.0, 3.0)]), small_stack(spacing_mm=2.0, thickness_mm=2.0)))
    one = examine_place(thick, np.array([1.0, 2.0, 3.0]), 11.5, SOLID)
    monkeypatch.setattr(logarithm, "lost_to_summing_hu", lambda scan, fit: np.zeros(len(fit.used)))
    assert told_by(thick, one) is None
