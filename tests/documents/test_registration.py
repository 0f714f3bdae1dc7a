"""registration.json and what is made of it for other tools."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
import SimpleITK

from ronnaplan.documents.export import export
from ronnaplan.documents.reading import to_json
from ronnaplan.documents.registration import read_registration
from ronnaplan.documents.registration_made import registration_document
from ronnaplan.documents.registration_text import registration_text
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame, Points
from ronnaplan.registration.marker_registration import register_markers
from tests.documents.registrations import SOURCE, refused, registered
from tests.registration import scene


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "registration.json"
    file.write_text(to_json(registered()))
    return file


def test_the_document_keeps_the_contract(path: Path) -> None:
    content = json.loads(path.read_text())
    assert (content["format"], content["version"], content["unit"]) == ("ronnaplan.registration", 1, "mm")
    assert content["status"] == "unique"
    assert content["pairs"][0].items() >= {"ct": "F1", "ots": "2"}.items()
    assert content["pairs"][0]["residual"] < 1
    assert (content["unpaired_ct"], content["unpaired_ots"]) == ([], [])
    np.testing.assert_allclose(np.array(content["ots_from_ct"])[:3, 3], scene.SHIFT, atol=1)
    assert content["targets"][0]["name"] == "left target"
    covariance = np.array(content["targets"][0]["covariance"])
    assert content["targets"][0]["predicted_tre_rms"] == pytest.approx(np.sqrt(np.trace(covariance)))
    assert content["source"]["frame_of_reference_uid"] == scene.CT.uid


def test_what_is_written_is_read_back_and_keeps_its_frame(path: Path) -> None:
    document = read_registration(path)
    assert document == registered()
    np.testing.assert_allclose(document.pose.matrix, np.array(registered().ots_from_ct), atol=1e-12)
    document.require_frame(scene.CT)
    with pytest.raises(FrameMismatchError):
        document.require_frame(Frame("CT", "9.9"))
    with pytest.raises(FrameMismatchError):
        document.pose.apply([[0, 0, 0]], Frame("CT", "9.9"))


def test_a_trajectory_with_the_longest_name_there_is_can_be_registered_for(path: Path) -> None:
    content, longest = json.loads(path.read_text()), f"{'n' * 500} target"
    content["targets"][0]["name"] = longest
    path.write_text(json.dumps(content))
    assert read_registration(path).targets[0].name == longest
    content["targets"][0]["name"] = f"n{longest}"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"targets\.0\.name: .* at most 507 characters"):
        read_registration(path)


def test_targets_of_another_scan_are_refused() -> None:
    found = register_markers(scene.ct_points(), scene.readings())
    other = Points(np.zeros((1, 3)), np.zeros((1, 3, 3)), ("t",), Frame("CT", "9.9"))
    with pytest.raises(FrameMismatchError):
        registration_document(found, SOURCE, other)


def test_a_refused_pairing_is_a_document_with_rivals_and_no_transform(tmp_path: Path) -> None:
    file = tmp_path / "refused.json"
    file.write_text(to_json(refused()))
    document = read_registration(file)
    assert document.status == "ambiguous"
    assert len(document.rivals) >= 2
    assert document.ots_from_ct is None
    with pytest.raises(InputError, match="refused"):
        _ = document.pose
    with pytest.raises(InputError, match="refused"):
        _ = document.readings
    for to in ("itk", "dicom", "ros", "csv", "markups"):
        with pytest.raises(InputError, match="refused"):
            export(file, to)
    assert "rival 2" in registration_text(document)
    assert (
        repr(document)
        == str(document)
        == f"RegistrationDocument(ambiguous: {document.reason}; {len(document.rivals)} rivals)"
    )


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"format": "ronnaplan.fiducials"}, "not a registration"),
        ({"version": 2}, "version 2"),
        ({"ots_from_ct": None}, "lacks ots_from_ct"),
        ({"ots_from_ct": np.diag([-1.0, 1, 1, 1]).tolist()}, "left-handed"),
        ({"covariance": (-np.eye(6)).tolist()}, "not symmetric and positive"),
        ({"covariance": np.zeros((6, 6)).tolist()}, "not symmetric and positive"),
        ({"status": "ambiguous"}, "is ambiguous, yet holds"),
        ({"pairs": []}, "0 pairs"),
        ({"fre_rms": -1}, "fre_rms"),
        ({"status": "fine"}, "status"),
    ],
)
def test_a_spoilt_document_is_named(path: Path, change: dict[str, object], says: str) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=says):
        read_registration(path)


@pytest.mark.parametrize(
    ("place", "change", "says"),
    [
        (("pairs", 1, "residual"), 1e-4, "the residual of F2 is"),
        (("pairs", 1, "center", 2), 1e-4, "the residual of F2 is"),
        (("pairs", 1, "reading", 0), 1e-4, "the residual of F2 is"),
        (("ots_from_ct", 0, 3), 1e-4, "the residual of F1 is"),
        (("fre_rms",), 1e-4, "fre_rms is"),
        (("targets", 0, "center", 1), 1.0, "the covariance of left target is not that of the transform"),
    ],
)
def test_a_figure_that_contradicts_what_it_is_taken_from_is_refused(
    path: Path, place: tuple[str | int, ...], change: float, says: str
) -> None:
    content = json.loads(path.read_text())
    part = content
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] += change
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=says):
        read_registration(path)


def test_a_target_covariance_of_another_place_is_refused(path: Path) -> None:
    content = json.loads(path.read_text())
    first, second = content["targets"]
    for key in ("covariance", "predicted_tre_rms"):
        first[key], second[key] = second[key], first[key]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="not that of the transform at its place"):
        read_registration(path)


@pytest.mark.parametrize("side", ["ct", "ots"])
def test_a_marker_paired_twice_is_refused(path: Path, side: str) -> None:
    content = json.loads(path.read_text())
    content["pairs"][1][side] = content["pairs"][0][side]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="each once"):
        read_registration(path)


@pytest.mark.parametrize("side", ["ct", "ots"])
def test_a_marker_that_is_paired_and_left_out_is_refused(path: Path, side: str) -> None:
    content = json.loads(path.read_text())
    label = content["pairs"][1][side]
    content[f"unpaired_{side}"] = ["another", label]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"{label} is in a pair, and in unpaired_{side}, too"):
        read_registration(path)


def test_only_a_unique_registration_gives_a_pose() -> None:
    with pytest.raises(InputError, match="refused"):
        _ = registered().model_copy(update={"status": "ambiguous"}).pose


def test_the_text_tells_residuals_targets_and_that_fre_is_not_the_target_error() -> None:
    text = registration_text(registered())
    assert "do not measure the error at a target" in text
    assert f"fit probability {registered().fit_probability:.3g}: " in text
    assert "below 0.001 or above 0.999 is a warning" in text
    assert "left target" in text
    assert "F5" in text


def test_the_text_stands_in_columns_whatever_the_names_are() -> None:
    """A terminal gives a Chinese letter two columns, and an accent none of its own."""
    document = registered()
    targets = (document.targets[0].model_copy(update={"name": "\u6d77\u99ac" * 9}), *document.targets[1:])
    pairs = (document.pairs[0].model_copy(update={"ct": "behind the ear e\u0301"}), *document.pairs[1:])
    lines = registration_text(document.model_copy(update={"targets": targets, "pairs": pairs})).splitlines()
    head, _, marked, *plain = lines[: 2 + len(pairs)]
    assert {len(marked) - 1, *map(len, plain)} == {len(head)}
    *_, column, centroid, wide, last = lines
    assert {len(centroid), len(wide) + 18, len(last)} == {len(column)}


def test_without_a_target_the_text_tells_the_error_at_the_markers_centroid() -> None:
    document = registered().model_copy(update={"targets": ()})
    centroid = np.mean([pair.center for pair in document.pairs], axis=0, keepdims=True)
    covariance = document.pose.point_covariances(centroid)[0]
    last = registration_text(document).splitlines()[-1]
    assert last.startswith("markers' centroid")
    assert float(last.split()[-2]) == pytest.approx(np.sqrt(np.trace(covariance)), abs=0.006)
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(3), covariance, 100_000)
    assert float(last.split()[-1]) == pytest.approx(np.quantile(np.linalg.norm(drawn, axis=1), 0.95), abs=0.008)


def test_the_itk_transform_maps_tracker_points_to_ct_points(path: Path, tmp_path: Path) -> None:
    """Slicer's convention: a .tfm holds "from parent", so points move by its inverse when it is put on the CT."""
    file = tmp_path / "registration.tfm"
    text = export(path, "itk")
    assert isinstance(text, str)
    file.write_text(text)
    transform = SimpleITK.ReadTransform(str(file))
    document = read_registration(path)
    for place in scene.HEAD:
        tracker = document.pose.apply([place])[0]
        np.testing.assert_allclose(transform.TransformPoint(tracker.tolist()), place, atol=1e-9)
        np.testing.assert_allclose(transform.GetInverse().TransformPoint(place.tolist()), tracker, atol=1e-9)


def test_the_table_holds_residuals_and_places(path: Path) -> None:
    text = export(path, "csv")
    assert isinstance(text, str)
    rows = list(csv.DictReader(io.StringIO(text)))
    document = registered()
    assert [row["ct"] for row in rows] == ["F1", "F2", "F3", "F4", "F5"]
    for row, pair in zip(rows, document.pairs, strict=True):
        assert float(row["residual"]) == pytest.approx(pair.residual, abs=1e-6)
        place = [float(row[f"ct_{axis}"]) for axis in "xyz"]
        tracker = np.array([float(row[f"ots_{axis}"]) for axis in "xyz"])
        off = np.linalg.norm(tracker - document.pose.apply([place])[0])
        assert off == pytest.approx(pair.residual, abs=1e-5)


def test_markups_are_coloured_by_residual(tmp_path: Path) -> None:
    seen = scene.readings(sd_mm=0.02)
    seen.positions_mm[0] += (1.2, 0, 0)  # F4
    document = registration_document(register_markers(scene.ct_points(), seen), SOURCE)
    file = tmp_path / "registration.json"
    file.write_text(to_json(document))
    text = export(file, "markups")
    colours = {}
    for markup in json.loads(text)["markups"]:
        assert markup["coordinateSystem"] == "LPS"
        for point in markup["controlPoints"]:
            colours[point["label"]] = markup["display"]["selectedColor"]
            assert "residual" in point["description"]
            assert point["position"] == scene.HEAD[int(point["label"][1]) - 1].tolist()
    assert len(colours) == 5
    assert colours["F4"] != colours["F3"]
