"""fiducials.json says what the contract says, and a damaged one is refused in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.ct import SeriesSource
from ronnaplan.documents.fiducials import FEW, fiducials_document, read_fiducials
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import InputError
from ronnaplan.localization import Fiducial, FiducialFlag, Fiducials, Rejected
from tests import cases

FIT = cases.ball_parameters(radius=5.76)


COVARIANCE = np.array([[4e-6, 1e-6, 0], [1e-6, 9e-6, 0], [0, 0, 2.5e-5]])
PLACE = np.array([9.0, 9.0, 9.0])
FOUND = Fiducials(
    (
        Fiducial(
            "F1", np.array([1.0, -2.0, 3.5]), COVARIANCE, COVARIANCE / 2, FIT, 0.8, 0.01, (FiducialFlag.CUT,)
        ),
        Fiducial("F2", np.array([0.1, 0.2, 1.0 / 3.0]), COVARIANCE, COVARIANCE / 2, FIT, 0.9, 0.01),
    ),
    (Rejected(PLACE, "roundness", "its surface is not a sphere's", FIT, PLACE),),
    (11.5,),
    SeriesSource("1.2", "1.2.3", "1.2.3.4"),
    "ab" * 32,
)


@pytest.fixture
def document(tmp_path: Path) -> Path:
    path = tmp_path / "fiducials.json"
    path.write_text(to_json(fiducials_document(FOUND)))
    return path


def test_the_document_keeps_its_contract(document: Path) -> None:
    content = json.loads(document.read_text())
    assert content["format"] == "ronnaplan.fiducials"
    assert content["version"] == 1
    assert content["coordinate_system"] == "LPS"
    assert content["unit"] == "mm"
    assert content["source"]["frame_of_reference_uid"] == "1.2.3.4"
    assert content["source"]["voxel_sha256"] == "ab" * 32
    assert content["marker"]["diameter_mm"] == 11.5
    first = content["fiducials"][0]
    assert first["center"] == [1.0, -2.0, 3.5]
    assert {"label", "center", "covariance", "diameter_mm", "contrast_hu", "flags"} <= set(first)
    assert first["flags"] == ["cut"]
    assert content["rejected"][0]["reason"] == "its surface is not a sphere's"
    assert content["software"]["name"] == "ronnaplan"


def test_points_survive_the_file_to_the_last_bit(document: Path) -> None:
    points = read_fiducials(document).points
    assert (points.positions_mm == FOUND.centers).all()
    assert (points.covariances_mm2 == FOUND.covariances).all()
    assert points.labels == FOUND.labels
    assert points.frame == FOUND.points.frame


@pytest.mark.parametrize(("layer_mm", "radius_mm"), [(0.0, 5.76), (-1.0, 5.76), (1.5, 7.26)])
def test_what_a_marker_is_wrapped_in_makes_it_larger_and_its_cavity_does_not(
    document: Path, layer_mm: float, radius_mm: float
) -> None:
    content = json.loads(document.read_text())
    content["marker"]["layer_mm"] = layer_mm
    document.write_text(json.dumps(content))
    np.testing.assert_allclose(read_fiducials(document).radii_mm, [radius_mm] * 2)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"format": "something.else"}, "not a fiducials document"),
        ({"version": 2}, "reads version 1"),
        ({"coordinate_system": "RAS"}, "coordinate_system"),
        ({"fiducials": [{"label": "F1"}]}, r"fiducials\.0\.center"),
        ({"marker": {"diameter_mm": -1}}, "marker.diameter_mm"),
        (
            {"resolution": {"blur_mm": 1, "profile_fwhm_mm": 3, "profile_shape": 4, "profile_axis": [0, 0, 2]}},
            r"resolution\.profile_axis: has the length 2; expected 1",
        ),
    ],
)
def test_a_wrong_document_is_refused_by_the_field(document: Path, change: dict[str, Any], complaint: str) -> None:
    document.write_text(json.dumps(json.loads(document.read_text()) | change))
    with pytest.raises(InputError, match=complaint):
        read_fiducials(document)


@pytest.mark.parametrize(
    ("entry", "value", "complaint"),
    [
        (
            "covariance",
            [[1, 0, 0], [0, -1, 0], [0, 0, 1]],
            r"0\.covariance: is not symmetric and positive definite",
        ),
        (
            "covariance",
            [[1, 2, 0], [0, 1, 0], [0, 0, 1]],
            r"0\.covariance: is not symmetric and positive definite",
        ),
        ("label", "F2", "two fiducials have the same name"),
        ("label", " F2", "the names ' F2' and 'F2' of two fiducials read as one"),
        ("center", [1, 2, float("nan")], "NaN is no number"),
    ],
)
def test_a_marker_that_cannot_be_is_refused(document: Path, entry: str, value: object, complaint: str) -> None:
    content = json.loads(document.read_text())
    content["fiducials"][0][entry] = value
    document.write_text(json.dumps(content))
    with pytest.raises(InputError, match=complaint):
        read_fiducials(document)


@pytest.mark.parametrize("others", [0, FEW])
@pytest.mark.parametrize(("shift_mm", "is_one"), [(0.0, True), (2.8, True), (2.9, False)])
def test_two_markers_at_one_place_are_refused_by_their_names(
    document: Path, shift_mm: float, is_one: bool, others: int
) -> None:
    content = json.loads(document.read_text())
    first = content["fiducials"][0]
    x, y, z = first["center"]
    content["fiducials"].append(first | {"label": "again", "center": [x, y, z + shift_mm]})
    for n in range(1, others + 1):
        content["fiducials"].append(first | {"label": f"other {n}", "center": [x + 10.0 * n, y, z]})
    document.write_text(json.dumps(content))
    if not is_one:
        assert len(read_fiducials(document).fiducials) == len(content["fiducials"])
        return
    with pytest.raises(
        InputError, match=rf"F1 and again are {shift_mm:.3g} mm apart; expected 2\.8\d mm at least"
    ):
        read_fiducials(document)


@pytest.mark.parametrize("content", [b"", b"{", b"[1, 2]", b"\xff\xfe\x00", b"null", b"[" * 100_000])
def test_what_is_no_document_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad.json").write_bytes(content)
    with pytest.raises(InputError):
        read_fiducials(tmp_path / "bad.json")
    with pytest.raises(InputError, match="cannot be read"):
        read_fiducials(tmp_path / "missing.json")
