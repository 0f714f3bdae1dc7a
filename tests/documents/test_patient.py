"""A DICOM export names the scan's patient and study where that is asked for, and the right ones or none."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest
from pydicom import dcmread
from pydicom.dataset import Dataset, FileDataset

from ronnaplan.cli import main
from ronnaplan.documents.export import export
from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import FrameMismatchError, InputError, UsageError
from tests import cases
from tests.ct import makers

SOURCE = Source(
    study_instance_uid=makers.STUDY, series_instance_uid=makers.SERIES, frame_of_reference_uid=makers.FRAME
)


def identify(made: Dataset, k: int) -> None:
    made.SpecificCharacterSet = "ISO_IR 100"
    made.PatientName, made.PatientID, made.IssuerOfPatientID = "Müller^Jörg", "4711", "St. Mary"
    made.PatientBirthDate, made.PatientSex = "19700131", "M"
    made.StudyDate, made.StudyTime, made.AccessionNumber = "20260102", "101112", "A1"
    made.StudyDescription, made.StudyID = "Kopf", "7"


@pytest.fixture
def ct(tmp_path: Path) -> Path:
    return makers.write_series(tmp_path / "ct", change=identify)


def document(folder: Path, kind: str, **changes: str) -> Path:
    made = cases.fiducials() if kind == "fiducials" else cases.registration()
    file = folder / f"{kind}.json"
    file.write_text(to_json(made.model_copy(update={"source": SOURCE.model_copy(update=changes)})))
    return file


def exported(file: Path, ct: Path | None) -> FileDataset:
    made = export(file, "dicom", ct)
    assert isinstance(made, bytes)
    return dcmread(BytesIO(made))


@pytest.mark.parametrize("kind", ["fiducials", "registration"])
def test_the_patient_and_the_study_are_those_of_the_scan(kind: str, ct: Path, tmp_path: Path) -> None:
    made = exported(document(tmp_path, kind), ct)
    assert (str(made.PatientName), made.PatientID, made.IssuerOfPatientID) == ("Müller^Jörg", "4711", "St. Mary")
    assert (made.PatientBirthDate, made.PatientSex) == ("19700131", "M")
    assert (made.StudyInstanceUID, made.StudyDate, made.StudyTime) == (makers.STUDY, "20260102", "101112")
    assert (made.AccessionNumber, made.StudyID, made.StudyDescription) == ("A1", "7", "Kopf")
    if shutil.which("dciodvfy"):
        (tmp_path / "o.dcm").write_bytes(bytes(export(document(tmp_path, kind), "dicom", ct)))  # type: ignore[arg-type]
        told = subprocess.run(
            ["dciodvfy", "-new", tmp_path / "o.dcm"], capture_output=True, text=True, check=False
        )
        assert "Error" not in told.stderr, told.stderr


def test_without_being_asked_for_they_stay_empty_and_the_object_is_another(ct: Path, tmp_path: Path) -> None:
    file = document(tmp_path, "fiducials")
    named, nameless = exported(file, ct), exported(file, None)
    assert (str(nameless.PatientName), nameless.PatientID, nameless.StudyDate) == ("", "", "")
    assert b"St. Mary" not in export(file, "dicom")  # digits alone may stand in a UID by chance
    assert named.SOPInstanceUID != nameless.SOPInstanceUID


def one_other(keyword: str, value: str) -> Callable[[Dataset, int], None]:
    def change(made: Dataset, k: int) -> None:
        identify(made, k)
        if k == 2:
            setattr(made, keyword, value)

    return change


@pytest.mark.parametrize(
    ("keyword", "value"), [("PatientID", "4712"), ("PatientName", "Doe^John"), ("StudyDate", "20260103")]
)
def test_files_of_two_patients_name_none(keyword: str, value: str, tmp_path: Path) -> None:
    mixed = makers.write_series(tmp_path / "ct", change=one_other(keyword, value))
    with pytest.raises(InputError, match=f"differ in {keyword}"):
        exported(document(tmp_path, "fiducials"), mixed)


@pytest.mark.parametrize(
    ("changes", "says", "error"),
    [
        ({"series_instance_uid": "1.9"}, "does not hold series 1.9", InputError),
        ({"series_instance_uid": None}, "names no series", InputError),
        ({"study_instance_uid": "1.9"}, "is of study", InputError),
        ({"frame_of_reference_uid": "1.9"}, "frame of reference", FrameMismatchError),
    ],
)
def test_another_scan_than_the_document_s_is_refused(
    changes: dict[str, str], says: str, error: type[InputError], ct: Path, tmp_path: Path
) -> None:
    with pytest.raises(error, match=says):
        exported(document(tmp_path, "fiducials", **changes), ct)


UNKNOWN = {
    "PatientBirthDate": "1970.01.31",
    "PatientBirthTime": "noon",
    "PatientSex": "male",
    "PatientIdentityRemoved": "Yes",
    "StudyDate": "00000000",
    "StudyTime": "unknown",
}


@pytest.mark.parametrize("keyword", sorted(UNKNOWN))
@pytest.mark.filterwarnings("ignore:Invalid value for VR:UserWarning")
def test_a_date_a_time_or_a_code_that_dicom_does_not_know_is_left_empty_and_told(
    keyword: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def change(made: Dataset, k: int) -> None:
        identify(made, k)
        setattr(made, keyword, UNKNOWN[keyword])

    ct, file, target = (
        makers.write_series(tmp_path / "ct", change=change),
        document(tmp_path, "fiducials"),
        "o.dcm",
    )
    arguments = ["export", file, "--to", "dicom", "--ct", ct, "-o", tmp_path / target]
    assert main([str(part) for part in arguments]) == 0
    (told,) = capsys.readouterr().err.splitlines()
    assert told.startswith(f"ronnaplan: warning: the scan's {keyword} is none that DICOM knows, and is left empty")
    assert UNKNOWN[keyword] not in told
    made = dcmread(tmp_path / target)
    assert not made[keyword].value
    assert (str(made.PatientName), made.PatientID, made.StudyInstanceUID) == ("Müller^Jörg", "4711", makers.STUDY)
    if shutil.which("dciodvfy"):
        said = subprocess.run(["dciodvfy", "-new", tmp_path / target], capture_output=True, text=True, check=False)
        assert "Error" not in said.stderr, said.stderr


@pytest.mark.filterwarnings("ignore:Invalid value for VR:UserWarning")
def test_files_of_two_birth_dates_name_nobody_though_neither_is_a_date(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        identify(made, k)
        made.PatientBirthDate = "31011970" if k else "30011970"

    with pytest.raises(InputError, match="differ in PatientBirthDate"):
        exported(document(tmp_path, "fiducials"), makers.write_series(tmp_path / "ct", change=change))


@pytest.mark.filterwarnings("ignore:The number of PN components:UserWarning")
def test_a_name_that_is_none_is_not_copied_and_stands_in_no_message(tmp_path: Path) -> None:
    def change(made: Dataset, k: int) -> None:
        identify(made, k)
        made.PatientName = "Doe=Jane=J=D"

    ct = makers.write_series(tmp_path / "ct", change=change)
    says = r"the PatientName of \S+ cannot be copied \(The number .*\); correct its header"
    with pytest.raises(InputError, match=says) as refused:
        exported(document(tmp_path, "fiducials"), ct)
    assert "Doe" not in str(refused.value)


def test_a_misspelt_character_set_and_a_backslash_are_copied_as_they_stand(tmp_path: Path) -> None:
    """``ISO IR 100`` kept all answers back, and ``a\\b`` was copied as ['a', 'b']."""

    def change(made: Dataset, k: int) -> None:
        identify(made, k)
        made.StudyDescription, made.ReferringPhysicianName = ["Kopf", "Hals"], ["A", "B"]

    ct = makers.write_series(tmp_path / "ct", change=change)
    for path in ct.iterdir():
        path.write_bytes(path.read_bytes().replace(b"ISO_IR 100", b"ISO IR 100"))
    made = exported(document(tmp_path, "fiducials"), ct)
    assert (made.PatientName, made.StudyDescription) == ("Müller^Jörg", ["Kopf", "Hals"])
    assert made.ReferringPhysicianName == ["A", "B"]


def test_words_in_another_character_set_than_is_stated_keep_no_object_back(tmp_path: Path) -> None:
    """A node found six markers and answered nothing, for one letter of the study's description."""

    def change(made: Dataset, k: int) -> None:
        identify(made, k)
        made.SpecificCharacterSet = "ISO_IR 192"
        made.StudyDescription, made.ReferringPhysicianName = "description", "physician"

    ct = makers.write_series(tmp_path / "ct", change=change)
    for path in ct.iterdir():
        path.write_bytes(
            path.read_bytes().replace(b"description", b"Sch\xe4del_CT_").replace(b"physician", b"Gr\xe4fin_A.")
        )
    made = exported(document(tmp_path, "fiducials"), ct)
    assert (made.PatientName, made.StudyDescription, made.ReferringPhysicianName) == ("Müller^Jörg", "", "")


@pytest.mark.parametrize("unknown", ["ISO_IR 999", "ISO 2022 IR 999", "ISO_IR 192\\ISO_IR 100"])
def test_an_unknown_character_set_costs_only_the_words_whose_letters_it_decides(
    tmp_path: Path, unknown: str
) -> None:
    """It kept all objects back, of patients with plain names, too."""

    def change(made: Dataset, k: int) -> None:
        identify(made, k)
        made.PatientName, made.StudyDescription = "Doe^Jane", "Schädel"

    def restate(path: Path) -> None:
        known = b"\x08\0\x05\0CS\x0a\0ISO_IR 100"
        other = unknown.encode() + b" " * (len(unknown) % 2)
        content = path.read_bytes()
        assert known in content
        path.write_bytes(content.replace(known, b"\x08\0\x05\0CS" + len(other).to_bytes(2, "little") + other))

    plain, accented = (
        makers.write_series(tmp_path / name, change=made) for name, made in (("a", change), ("b", identify))
    )
    for path in (*plain.iterdir(), *accented.iterdir()):
        restate(path)
    made = exported(document(tmp_path, "fiducials"), plain)
    assert (made.PatientName, made.PatientID, made.StudyDescription) == ("Doe^Jane", "4711", "")
    says = r"the PatientName of \S+ cannot be copied \(letters of an unknown character set\); correct its header"
    with pytest.raises(InputError, match=says):
        exported(document(tmp_path, "fiducials"), accented)


@pytest.mark.filterwarnings("ignore:The .* length:UserWarning")
def test_names_and_numbers_that_are_too_long_are_copied_as_they_stand(tmp_path: Path) -> None:
    number, name = "2026010210111200047", "Müller" * 11

    def long(made: Dataset, k: int) -> None:
        identify(made, k)
        made.AccessionNumber = made.StudyID = number
        made.PatientName = name

    made = exported(document(tmp_path, "fiducials"), makers.write_series(tmp_path / "ct", change=long))
    assert (made.AccessionNumber, made.StudyID, str(made.PatientName)) == (number, number, name)


def test_a_text_of_another_alphabet_than_it_says_is_told_in_a_sentence(tmp_path: Path) -> None:
    ct = makers.write_series(tmp_path / "ct", change=identify)
    for file in ct.iterdir():
        content = file.read_bytes()
        assert b"ISO_IR 100" in content
        file.write_bytes(content.replace(b"ISO_IR 100", b"ISO_IR 192"))
    with pytest.raises(InputError) as refused:
        exported(document(tmp_path, "fiducials"), ct)
    assert "Failed to decode" in str(refused.value)
    assert "Traceback" not in str(refused.value)


def test_only_dicom_names_a_patient_and_an_unknown_format_is_wrong_usage(ct: Path, tmp_path: Path) -> None:
    for kind in ("fiducials", "registration"):
        with pytest.raises(UsageError, match="names no patient"):
            export(document(tmp_path, kind), "csv", ct)
        with pytest.raises(UsageError, match="cannot become 'foo'; choose one of markups, csv"):
            export(document(tmp_path, kind), "foo")
    with pytest.raises(UsageError, match="fiducials cannot become 'itk'"):
        export(document(tmp_path, "fiducials"), "itk")
