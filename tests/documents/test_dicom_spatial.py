"""Registrations and markers as DICOM objects, which an independent validator finds nothing wrong with."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from pydicom import dcmread

from ronnaplan.documents.dicom_spatial import _identifiers, dicom_bytes, spatial_fiducials, spatial_registration
from ronnaplan.documents.fiducials import Source
from ronnaplan.errors import InputError
from tests.documents.registrations import SOURCE, fiducials, registered
from tests.registration import scene


@pytest.mark.parametrize("uid", ["bad\\x", "1" * 65, "1.2 3"])
@pytest.mark.parametrize("field", ["frame_of_reference_uid", "study_instance_uid"])
def test_no_dicom_object_is_written_with_an_invalid_uid(uid: str, field: str) -> None:
    source = SOURCE.model_copy(update={field: uid})
    with pytest.raises(InputError, match="not a DICOM UID"):
        spatial_registration(registered().model_copy(update={"source": source}))
    with pytest.raises(InputError, match="not a DICOM UID"):
        spatial_fiducials(fiducials().model_copy(update={"source": source}))


def test_the_spatial_registration_maps_the_scan_into_its_own_frame(tmp_path: Path) -> None:
    file = tmp_path / "registration.dcm"
    document = registered()
    file.write_bytes(dicom_bytes(spatial_registration(document)))
    dataset = dcmread(file)
    assert dataset.SOPClassUID.name == "Spatial Registration Storage"
    assert dataset.SeriesDescription == "CT to tracker"
    scan, itself = dataset.RegistrationSequence
    assert scan.FrameOfReferenceUID == scene.CT.uid
    assert itself.FrameOfReferenceUID == dataset.FrameOfReferenceUID != scene.CT.uid
    step = scan.MatrixRegistrationSequence[0].MatrixSequence[0]
    matrix = np.array(step.FrameOfReferenceTransformationMatrix, dtype=float).reshape(4, 4)
    np.testing.assert_allclose(matrix, document.pose.matrix, atol=1e-8)
    again = spatial_registration(document)
    assert (again.SOPInstanceUID, again.FrameOfReferenceUID) == (
        dataset.SOPInstanceUID,
        dataset.FrameOfReferenceUID,
    )


def test_the_spatial_fiducials_are_the_markers(tmp_path: Path) -> None:
    file = tmp_path / "fiducials.dcm"
    file.write_bytes(dicom_bytes(spatial_fiducials(fiducials())))
    dataset = dcmread(file)
    assert dataset.SeriesDescription == "5 markers"
    (markers,) = dataset.FiducialSetSequence
    assert markers.FrameOfReferenceUID == scene.CT.uid
    places = np.array([item.ContourData for item in markers.FiducialSequence], dtype=float)
    np.testing.assert_allclose(places, scene.HEAD / 3, atol=1e-9)
    assert [item.FiducialIdentifier for item in markers.FiducialSequence] == ["F1", "F2", "F3", "F4", "F5"]
    assert markers.FiducialSequence[0].ContourUncertaintyRadius == pytest.approx(np.sqrt(3e-4))


def test_markers_with_long_names_keep_identifiers_of_their_own(tmp_path: Path) -> None:
    """A Short String holds 16 characters, and a backslash ends a value."""
    long = "behind the left ear, "
    labels = [f"{long}first", f"{long}second", "a\\b", "behind the left~2", "F5"]
    document = fiducials()
    named = [
        one.model_copy(update={"label": label}) for one, label in zip(document.fiducials, labels, strict=True)
    ]
    file = tmp_path / "fiducials.dcm"
    file.write_bytes(dicom_bytes(spatial_fiducials(document.model_copy(update={"fiducials": tuple(named)}))))
    (markers,) = dcmread(file).FiducialSetSequence
    found = [item.FiducialIdentifier for item in markers.FiducialSequence]
    assert found == ["behind the left", "behind the lef~2", "a/b", "behind the left~", "F5"]
    described = [item.FiducialDescription for item in markers.FiducialSequence]
    assert described[1:3] == [f"sphere 11.50 mm, {long}second", "sphere 11.50 mm, a/b"]
    assert described[4] == "sphere 11.50 mm"


def test_thousands_of_alike_names_are_numbered_at_once() -> None:
    """A second each thousand, and four times as long for twice as many, were each number tried for each name."""
    found = _identifiers(["behind the left ear, the third of the row"] * 5000)
    assert len(set(found)) == 5000
    assert found[:2] == ["behind the left", "behind the lef~2"]
    assert found[-1] == "behind the ~5000"


def test_blanks_before_a_name_do_not_tell_markers_apart(tmp_path: Path) -> None:
    """They do not count in a Short String, which sixteen of them would leave empty."""
    document = fiducials()
    labels = ["a", " a", f"{' ' * 16}b", "F4", "F5"]
    named = [
        one.model_copy(update={"label": label}) for one, label in zip(document.fiducials, labels, strict=True)
    ]
    file = tmp_path / "fiducials.dcm"
    file.write_bytes(dicom_bytes(spatial_fiducials(document.model_copy(update={"fiducials": tuple(named)}))))
    (markers,) = dcmread(file).FiducialSetSequence
    assert [item.FiducialIdentifier for item in markers.FiducialSequence] == ["a", "a~2", "b", "F4", "F5"]


@pytest.mark.skipif(shutil.which("dciodvfy") is None, reason="dciodvfy (dicom3tools) is not installed")
def test_both_objects_satisfy_an_independent_validator(tmp_path: Path) -> None:
    for dataset in (spatial_registration(registered()), spatial_fiducials(fiducials())):
        file = tmp_path / "object.dcm"
        file.write_bytes(dicom_bytes(dataset))
        told = subprocess.run(["dciodvfy", "-new", str(file)], capture_output=True, text=True, check=False).stderr
        assert "Error" not in told, told


def test_without_a_frame_of_reference_there_is_no_dicom_object() -> None:
    nowhere = registered().model_copy(update={"source": Source()})
    with pytest.raises(InputError, match="no Frame of Reference UID"):
        spatial_registration(nowhere)
    with pytest.raises(InputError, match="no Frame of Reference UID"):
        spatial_fiducials(fiducials().model_copy(update={"source": Source()}))
    with pytest.raises(InputError, match="no fiducials"):
        spatial_fiducials(fiducials().model_copy(update={"fiducials": ()}))
