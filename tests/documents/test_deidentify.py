"""Nothing that the standard's profile lists as naming somebody is left, and everything an image shows is."""

from __future__ import annotations

import errno
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pydicom.data
import pytest
from dicomanonymizer.dicom_anonymization_databases import dicomfields_2026c as independent
from pydicom import dcmread, dcmwrite
from pydicom.datadict import tag_for_keyword
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence

from ronnaplan.cli import main
from ronnaplan.ct import read_ct
from ronnaplan.ct.files import Skipped
from ronnaplan.ct.folders import blobs_below
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.ct.system_folders import UNFINISHED
from ronnaplan.documents.basic_profile import DUMMIES, EMPTY, ENTERED, KEPT, REPLACED
from ronnaplan.documents.deidentify import WHOLE, deidentify
from ronnaplan.documents.dicom_spatial import spatial_fiducials, spatial_registration
from ronnaplan.documents.fiducials import Source, fiducials_document
from ronnaplan.documents.registration import read_registration
from ronnaplan.errors import InputError, UnwrittenError
from ronnaplan.jobs.localizing import warm_up
from tests.ct import makers
from tests.documents.test_patient import document

SECRET = bytes(range(32))
INDEX = Path(pydicom.data.__file__).parent / "test_files" / "dicomdirtests" / "DICOMDIR"
LISTS = ("D_TAGS", "Z_TAGS", "X_TAGS", "Z_D_TAGS", "X_Z_TAGS", "X_D_TAGS", "X_Z_D_TAGS", "X_Z_U_STAR_TAGS")
LISTED = {tuple(tag) for name in LISTS for tag in getattr(independent, name) if len(tag) == 2}
LISTED_UIDS = {tuple(tag) for tag in independent.U_TAGS if len(tag) == 2}


def _item(values: dict[str, Any]) -> Dataset:
    made = Dataset()
    for keyword, value in values.items():
        setattr(made, keyword, value)
    return made


def numbers(keywords: object) -> set[tuple[int, int]]:
    found = [tag_for_keyword(one) for one in keywords]  # type: ignore[attr-defined]
    assert None not in found
    return {(tag >> 16, tag & 0xFFFF) for tag in found if tag is not None}


def test_what_is_kept_is_nowhere_in_an_independent_list_of_the_profile() -> None:
    assert not numbers(KEPT | ENTERED) & (LISTED | LISTED_UIDS)
    assert numbers(REPLACED) <= LISTED_UIDS | numbers(
        ["SOPInstanceUIDOfConcatenationSource"]
    )  # the profile forgot it
    assert len(LISTED) > 400


def identified(made: Dataset, _: int) -> None:
    for group, element in sorted(LISTED):
        if group < 8 or 0x6000 <= group <= 0x60FF or (group, element) == (0x0040, 0xA730):
            continue
        try:
            made.add_new((group, element), _vr(group, element), _value(_vr(group, element)))
        except (KeyError, ValueError, TypeError):
            continue
    made.PatientName, made.PatientID, made.PatientBirthDate = "Doe^Jane", "SECRET123", "19700131"
    block = made.private_block(0x0099, "SECRET", create=True)
    block.add_new(1, "LO", "SECRET")
    inner = Dataset()
    inner.ReferencedSOPInstanceUID, inner.PatientName = "1.2.3.77", "SECRET"
    made.ReferencedImageSequence = Sequence([inner])


def _vr(group: int, element: int) -> str:
    from pydicom.datadict import dictionary_VR

    return dictionary_VR((group, element)).split(" or ")[0]


def _value(vr: str) -> object:
    if vr in ("LO", "SH", "LT", "ST", "UT", "PN", "UC", "AE", "CS"):
        return "SECRET"
    return {"DA": "19700131", "TM": "010101", "DT": "19700131010101", "UI": "1.2.3.77", "SQ": Sequence([])}[vr]


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    return makers.write_series(tmp_path / "Doe Jane", change=identified)


def test_no_name_number_or_date_is_left_anywhere(scan: Path, tmp_path: Path) -> None:
    deidentify(scan, tmp_path / "out", SECRET)
    known = {str(one.get("SOPInstanceUID")) for one in map(dcmread, scan.iterdir())}
    for path in (tmp_path / "out").iterdir():
        content = path.read_bytes()
        for secret in (b"SECRET", b"Doe", b"19700131", makers.STUDY.encode() + b"\0", b"1.2.3.77"):
            assert secret not in content
        left = dcmread(path)
        assert str(left.SOPInstanceUID) not in known
        present = {(element.tag.group, element.tag.element) for element in left.iterall() if element.value}
        own = numbers(("PatientName", "PatientID", "DeidentificationMethod", "DeidentificationMethodCodeSequence"))
        own |= numbers(DUMMIES)
        assert not present & LISTED - own
        assert not any(element.tag.is_private for element in left.iterall())
        for keyword in EMPTY:
            assert keyword in left
        assert left.PatientIdentityRemoved == "YES"
    assert "Doe" not in "".join(path.name for path in (tmp_path / "out").iterdir())


def test_the_image_is_the_same_and_its_files_still_belong_together(scan: Path, tmp_path: Path) -> None:
    assert deidentify(scan, tmp_path / "out", SECRET) == len(list(scan.iterdir()))
    before, after = read_ct(scan), read_ct(tmp_path / "out")
    assert np.array_equal(before.voxels_hu, after.voxels_hu)
    assert np.array_equal(before.grid.origins_mm, after.grid.origins_mm)
    deidentify(scan, tmp_path / "again", SECRET)
    assert read_ct(tmp_path / "again").source == after.source
    deidentify(scan, tmp_path / "other", SECRET[::-1])
    assert read_ct(tmp_path / "other").source.series_instance_uid != after.source.series_instance_uid


def test_what_may_show_a_name_or_is_not_known_is_refused(tmp_path: Path) -> None:
    for number, (keyword, value, says) in enumerate(
        [
            ("BurnedInAnnotation", "YES", "annotations"),
            ("SOPClassUID", "1.2.840.10008.5.1.4.1.1.7", "only CT"),
            ("SOPInstanceUID", "", "no SOP Instance UID"),
        ]
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        made = makers.dataset(0)
        setattr(made, keyword, value)
        made.save_as(folder / "x.dcm", enforce_file_format=True)
        with pytest.raises(InputError, match=says):
            deidentify(folder, tmp_path / f"out{number}", SECRET)


@pytest.mark.skipif(shutil.which("dciodvfy") is None, reason="dciodvfy is not installed (see .ci/run)")
@pytest.mark.parametrize("is_signed", [False, True])
@pytest.mark.parametrize("syntax", ["1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2"])
def test_an_overlay_in_the_pixels_unused_bits_goes_with_its_group(
    syntax: str, is_signed: bool, tmp_path: Path
) -> None:
    values = makers.pattern(3) - (300 if is_signed else 0)
    made = makers.dataset(0, stored=(values & 0x0FFF | 0x5000 * (values % 3 == 0)).astype("<u2"))
    made.BitsStored, made.HighBit, made.PixelRepresentation = 12, 11, int(is_signed)
    values[0, 0] = -2000 - 4096  # padding beyond the stored bits stays what it is
    made.PixelData = values[0, 0].tobytes() + made.PixelData[2:]
    made.add_new("PixelPaddingValue", "US", 65536 - 2000 - 4096)
    made.add_new((0x6000, 0x0102), "US", 12)
    (tmp_path / "in").mkdir()
    makers.save(made, tmp_path / "in/file", syntax)
    deidentify(tmp_path / "in", tmp_path / "out", SECRET)
    left = np.frombuffer(dcmread(tmp_path / "out/00001.dcm").PixelData, ">i2" if syntax.endswith("2.2") else "<i2")
    assert (left == values.ravel()).all()


def test_an_overlay_in_compressed_pixels_is_refused(tmp_path: Path) -> None:
    made = makers.dataset(0, stored=makers.pattern(3).astype("<u2"))
    made.BitsStored, made.HighBit = 12, 11
    made.add_new((0x6000, 0x0102), "US", 12)
    (tmp_path / "in").mkdir()
    made = makers.compress(made, "1.2.840.10008.1.2.5", tmp_path)
    makers.save(made, tmp_path / "in/file")
    with pytest.raises(InputError, match="compressed pixels hold an overlay"):
        deidentify(tmp_path / "in", tmp_path / "out", SECRET)
    made[0x6000, 0x0102].value = 0  # it has data of its own, which go
    makers.save(made, tmp_path / "in/file")
    assert deidentify(tmp_path / "in", tmp_path / "beside", SECRET) == 1


def test_values_that_end_beyond_their_words_are_refused(tmp_path: Path) -> None:
    made = makers.dataset(0, stored=makers.pattern(3).astype("<u2"))
    made.BitsStored, made.HighBit = 12, 40
    (tmp_path / "in").mkdir()
    makers.save(made, tmp_path / "in/file")
    with pytest.raises(InputError, match="12 bits cannot end at bit 40"):
        deidentify(tmp_path / "in", tmp_path / "out", SECRET)


@pytest.mark.parametrize("is_implicit", [False, True])
def test_files_without_meta_information_are_taken_as_they_are_read(is_implicit: bool, tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.mkdir()
    for k in range(3):
        bare = Dataset(makers.dataset(k))
        dcmwrite(source / f"{k}", bare, implicit_vr=is_implicit, little_endian=True)
    deidentify(source, tmp_path / "out", SECRET)
    assert np.array_equal(read_ct(source).voxels_hu, read_ct(tmp_path / "out").voxels_hu)


def test_what_is_refused_leaves_no_part_that_could_be_taken_for_the_whole(scan: Path, tmp_path: Path) -> None:
    content = (scan / "003").read_bytes()
    pixels_end = content.index(makers.pattern(3).tobytes()) + makers.pattern(3).nbytes
    (scan / "DICOMDIR").write_bytes(INDEX.read_bytes())
    for end, reason in (
        (300, "its file meta information is broken"),
        (pixels_end - 9, "it ends within its pixels"),
    ):
        (scan / "003").write_bytes(content[:end])
        with pytest.raises(InputError, match=f"003: {reason}; copy it again"):
            deidentify(scan, tmp_path / "out", SECRET)
        assert not list((tmp_path / "out").iterdir())
    (scan / "003").write_bytes(b"")
    with pytest.raises(
        InputError, match="003: it is not a DICOM file, though it seems to have been; copy it again"
    ):
        deidentify(scan, tmp_path / "out", SECRET)
    (scan / "003").write_bytes(content)
    (scan / "004").symlink_to(tmp_path / "not mounted")
    with pytest.raises(InputError, match="004: it cannot be opened"):
        deidentify(scan, tmp_path / "out", SECRET)
    (scan / "004").unlink()
    assert deidentify(scan, tmp_path / "out", SECRET) == 4


@pytest.mark.parametrize(
    ("function", "place", "found"),
    [("module.write_atomically", UNFINISHED, 0), ("pathlib.Path.replace", WHOLE, 4)],
)
def test_a_run_that_is_killed_leaves_nothing_that_could_be_taken_for_the_whole(
    function: str, place: str, found: int, scan: Path, tmp_path: Path
) -> None:
    """A reader of scans finds no file, or all of them; and no later run takes them for its own."""
    out = tmp_path / "out"
    code = f"""
import os, pathlib, ronnaplan.documents.deidentify as module
function = {function}
def call_and_die(path, what):
    function(path, what)
    if path.name == "00003.dcm" and path.parent.name == {place!r}:
        os._exit(9)
{function} = call_and_die
module.deidentify({str(scan)!r}, {str(out)!r}, {SECRET!r})
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 9
    skipped: list[Skipped] = []
    assert len(list(blobs_below(out, DEFAULT_LIMITS, skipped))) == found
    assert len(skipped) == (found == 0)
    with pytest.raises(
        InputError, match="out is not empty" if found else "there: another run writes to it, or one"
    ):
        deidentify(scan, out, SECRET)
    shutil.rmtree(out)
    assert deidentify(scan, out, SECRET) == len(list(out.iterdir())) == 4


def test_an_empty_folder_is_filled_where_it_lies(
    scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may be a disk's own (a volume of a container), the current one, or in one that may not be written to."""
    here = tmp_path / "here"
    here.mkdir()
    number = here.stat().st_ino
    monkeypatch.chdir(here)
    assert deidentify(scan, ".", SECRET) == 4
    assert here.stat().st_ino == number
    assert sorted(path.name for path in here.iterdir()) == [f"{n:05d}.dcm" for n in range(1, 5)]


def test_a_disk_that_fails_while_files_are_moved_up_leaves_none(
    scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace = Path.replace

    def fails(path: Path, target: Path) -> Path:
        if path.parent.name == WHOLE and path.name == "00003.dcm":
            raise OSError(errno.EIO, "Input/output error")
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", fails)
    with pytest.raises(UnwrittenError, match=r"cannot write .*out: Input/output error; check its disk"):
        deidentify(scan, tmp_path / "out", SECRET)
    assert not list((tmp_path / "out").iterdir())


def test_patients_without_an_id_stay_apart_and_those_with_one_go_by_it(tmp_path: Path) -> None:
    people = [("", "Doe^Jane"), ("", "Doe^John"), ("", "Doe^Jane"), ("1", "Doe^Jane"), ("1", "DOE^JANE")]
    (tmp_path / "in").mkdir()
    for k, (number, name) in enumerate(people):
        made = makers.dataset(k)
        made.PatientID, made.PatientName = number, name
        made.BurnedInAnnotation = ""  # says nothing
        makers.save(made, tmp_path / "in" / str(k))
    deidentify(tmp_path / "in", tmp_path / "out", SECRET)
    first, second, again, *same = [str(dcmread(path).PatientID) for path in sorted((tmp_path / "out").iterdir())]
    assert len({first, second, same[0]}) == 3
    assert (again, same[1]) == (first, same[0])


def test_a_projection_that_the_description_tells_stays_one(tmp_path: Path) -> None:
    def projected(made: Dataset, _: int) -> None:
        made.ImageType, made.SeriesDescription = ["DERIVED", "SECONDARY", "AXIAL"], "Doe thin MIP coronal"

    source = makers.write_series(tmp_path / "in", change=projected)
    deidentify(source, tmp_path / "out", SECRET)
    for folder in (source, tmp_path / "out"):
        with pytest.raises(InputError, match="intensity projection"):
            read_ct(folder)
    assert list(dcmread(tmp_path / "out/00001.dcm").ImageType) == ["DERIVED", "SECONDARY", "AXIAL", "MIP"]


def test_what_was_valid_stays_valid(tmp_path: Path) -> None:
    source = Source(study_instance_uid="1.2.3", series_instance_uid="1.2.4", frame_of_reference_uid="1.2.5")
    markers = fiducials_document(warm_up()[1]).model_copy(update={"source": source})
    secret = markers.model_copy(
        update={"fiducials": (markers.fiducials[0].model_copy(update={"label": "SECRET"}),)}
    )
    timed = makers.enhanced(3, change=_timed)
    timed.ContentDate, timed.ContentTime, timed.AcquisitionDateTime = "19700131", "010101", "19700131010101"
    objects = {
        "CT": makers.dataset(0),
        "enhanced CT": timed,
        "legacy converted CT": converted(3),
        "fiducials": spatial_fiducials(secret),
        "registration": spatial_registration(read_registration(document(tmp_path, "registration"))),
    }
    for name, made in objects.items():
        before, after = tmp_path / name / "before.dcm", tmp_path / f"{name} out" / "00001.dcm"
        before.parent.mkdir()
        made.save_as(before, enforce_file_format=True)
        deidentify(before.parent, after.parent, SECRET)
        assert errors(after) <= errors(before), name
        content = after.read_bytes()
        assert b"SECRET" not in content
        assert b"19700131" not in content


@pytest.mark.skipif(shutil.which("dciodvfy") is None, reason="dciodvfy is not installed (see .ci/run)")
def test_an_enhanced_ct_as_its_scanner_made_it_stays_valid(tmp_path: Path) -> None:
    before, after = tmp_path / "in" / "before.dcm", tmp_path / "out" / "00001.dcm"
    before.parent.mkdir()
    as_its_scanner_made_it(3).save_as(before, enforce_file_format=True)
    assert errors(before) == set()
    deidentify(before.parent, after.parent, SECRET)
    assert errors(after) == set()
    assert b"SECRET" not in after.read_bytes()
    kept = dcmread(after).SharedFunctionalGroupsSequence[0]
    assert kept.CTExposureSequence[0].ExposureInmAs == 100.0
    assert kept.IrradiationEventIdentificationSequence[0].IrradiationEventUID != "1.2.3.88"


ORIGINAL = ["ORIGINAL", "PRIMARY", "VOLUME", "NONE"]
HEAD = {"CodeValue": "69536005", "CodingSchemeDesignator": "SCT", "CodeMeaning": "Head"}
DOSE_PHANTOM = {
    "CodeValue": "113690",
    "CodingSchemeDesignator": "DCM",
    "CodeMeaning": "IEC Head Dosimetry Phantom",
}
IMAGE = {
    **dict.fromkeys(("StudyDate", "StudyTime", "AccessionNumber", "ReferringPhysicianName", "StudyID"), ""),
    **dict.fromkeys(("PatientID", "PatientBirthDate", "PatientSex", "PositionReferenceIndicator"), ""),
    **dict.fromkeys(("Manufacturer", "ManufacturerModelName", "DeviceSerialNumber", "SoftwareVersions"), "SECRET"),
    **{"ImageType": ORIGINAL, "SeriesNumber": 1, "PatientPosition": "HFS", "AcquisitionContextSequence": []},
    **{"ContentDate": "19700131", "ContentTime": "010101", "AcquisitionDateTime": "19700131010101"},
    **{"AcquisitionDuration": 5.0, "ContentQualification": "RESEARCH", "LossyImageCompression": "00"},
    **{"BurnedInAnnotation": "NO", "PresentationLUTShape": "IDENTITY", "MultienergyCTAcquisition": "NO"},
}
FRAME_TYPE = {
    **{"PixelPresentation": "MONOCHROME", "VolumetricProperties": "VOLUME"},
    "VolumeBasedCalculationTechnique": "NONE",
}
MACROS: dict[str, dict[str, Any]] = {
    "FrameAnatomySequence": {"AnatomicRegionSequence": [_item(HEAD)], "FrameLaterality": "U"},
    "FrameVOILUTSequence": {"WindowCenter": 40, "WindowWidth": 400},
    "CTImageFrameTypeSequence": {"FrameType": ORIGINAL, **FRAME_TYPE},
    "IrradiationEventIdentificationSequence": {"IrradiationEventUID": "1.2.3.88"},
    "CTAcquisitionTypeSequence": {
        **{"AcquisitionType": "SPIRAL", "ConstantVolumeFlag": "NO", "FluoroscopyFlag": "NO"},
    },
    "CTAcquisitionDetailsSequence": {
        **{"RotationDirection": "CW", "RevolutionTime": 0.5, "SingleCollimationWidth": 0.6},
        **{"TotalCollimationWidth": 38.4, "TableHeight": 150.0, "GantryDetectorTilt": 0.0},
        "DataCollectionDiameter": 500.0,
    },
    "CTTableDynamicsSequence": {"TableSpeed": 38.4, "TableFeedPerRotation": 19.2, "SpiralPitchFactor": 0.5},
    "CTPositionSequence": {
        **{"TablePosition": 1.0, "DataCollectionCenterPatient": [0.0, 0.0, 1.0]},
        "ReconstructionTargetCenterPatient": [0.0, 0.0, 1.0],
    },
    "CTGeometrySequence": {"DistanceSourceToDetector": 1e3, "DistanceSourceToDataCollectionCenter": 570.0},
    "CTReconstructionSequence": {
        **{"ReconstructionAlgorithm": "FILTER_BACK_PROJ", "ConvolutionKernel": "H30"},
        **{"ConvolutionKernelGroup": "BRAIN", "ReconstructionDiameter": 250.0, "ReconstructionAngle": 360.0},
        **{"ReconstructionPixelSpacing": [0.5, 0.75], "ImageFilter": "NONE"},
    },
    "CTExposureSequence": {
        **{"ExposureTimeInms": 500.0, "XRayTubeCurrentInmA": 200.0, "ExposureInmAs": 100.0, "CTDIvol": 30.0},
        **{"ExposureModulationType": ["NONE"], "CTDIPhantomTypeCodeSequence": [_item(DOSE_PHANTOM)]},
    },
    "CTXRayDetailsSequence": {
        **{"KVP": 120, "FocalSpots": 1.2, "FilterType": "FLAT", "FilterMaterial": ["ALUMINUM"]},
    },
}
"""What a scanner tells of how it made an image (PS3.3, C.8.15.3)."""


def as_its_scanner_made_it(count: int) -> Dataset:
    """Return an enhanced CT with all that the standard requires of an original one."""
    made = makers.enhanced(count)
    del made.ConvolutionKernel
    for keyword, value in {**IMAGE, **FRAME_TYPE}.items():
        setattr(made, keyword, value)
    organization = {"DimensionOrganizationUID": "1.2.3.77"}
    made.DimensionOrganizationSequence = [_item(organization)]
    made.DimensionIndexSequence = [
        _item({**organization, "DimensionIndexPointer": pointer, "FunctionalGroupPointer": 0x00209111})
        for pointer in (0x00209056, 0x00209057)
    ]
    for keyword, values in MACROS.items():
        setattr(made.SharedFunctionalGroupsSequence[0], keyword, [_item(values)])
    for k, groups in enumerate(made.PerFrameFunctionalGroupsSequence):
        content = groups.FrameContentSequence[0]
        content.FrameReferenceDateTime = content.FrameAcquisitionDateTime = "19700131010101"
        content.DimensionIndexValues, content.FrameAcquisitionDuration = [1, k + 1], 500.0
        content.FrameAcquisitionNumber = 1
    return made


def converted(count: int) -> Dataset:
    """Return a legacy conversion, with a private attribute and a side in each frame's groups."""
    from highdicom.legacy import LegacyConvertedEnhancedCTImage

    slices = [makers.dataset(k) for k in range(count)]
    for one in slices:
        one.AccessionNumber = one.ReferringPhysicianName = one.StudyID = one.PatientBirthDate = one.PatientSex = ""
        one.BodyPartExamined, one.StationName = "HEAD", "SECRET"
        one.private_block(0x0099, "SECRET", create=True).add_new(1, "LO", f"SECRET {one.InstanceNumber}")
    made = LegacyConvertedEnhancedCTImage(slices, "1.2.3.7", 2, "1.2.3.8", 1)
    made._db_con.close()  # its own database of the frames: Python 3.13 warns of one that is left open
    return made


def _timed(groups: Dataset, _: int) -> None:
    groups.FrameContentSequence[0].FrameReferenceDateTime = "19700131010101"


def errors(path: Path) -> set[str]:
    told = subprocess.run(["dciodvfy", "-new", str(path)], capture_output=True, text=True, check=False).stderr
    return {line for line in told.splitlines() if line.startswith("Error")}


def test_it_is_a_way_of_exporting(scan: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["export", str(scan), "--deidentify", "-o", str(out)]) == 0
    assert len(list(out.iterdir())) == len(list(scan.iterdir()))
    assert main(["export", str(scan), "--deidentify", "-o", str(out)]) == 1
    assert main(["export", str(scan), "--deidentify"]) == 2
