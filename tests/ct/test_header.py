import struct
import zlib
from pathlib import Path

import pydicom
import pydicom.data
import pytest
from pydicom.dataset import Dataset
from pydicom.uid import RLELossless

from ronnaplan.ct import tags
from ronnaplan.ct.files import DamagedError, DiskFile, NotDicomError
from ronnaplan.ct.frames import images_of
from ronnaplan.ct.header import deflated_part, read_header
from ronnaplan.ct.limits import Limits
from ronnaplan.ct.slices import instance_from_header
from ronnaplan.ct.values import numbers
from ronnaplan.errors import InputError
from tests.ct.makers import compress, dataset, pattern, save

PACKAGED = sorted(
    path for path in (Path(pydicom.data.__file__).parent / "test_files").rglob("*") if path.is_file()
)
OPENING = b"\x09\x00\x01\x10SQ\0\0\xff\xff\xff\xff\xfe\xff\x00\xe0\xff\xff\xff\xff"


def blob(path: Path) -> DiskFile:
    return DiskFile(str(path), path.stat().st_size)


def written(path: Path, content: bytes) -> DiskFile:
    path.write_bytes(content)
    return blob(path)


@pytest.fixture
def plain(tmp_path: Path) -> bytes:
    save(dataset(0), tmp_path / "plain")
    return (tmp_path / "plain").read_bytes()


def nested(plain: bytes, depth: int) -> bytes:
    at = plain.find(b"\x10\x00\x10\x00PN")
    return plain[:at] + OPENING * depth + plain[at:]


@pytest.mark.filterwarnings("ignore::UserWarning:pydicom")
def test_every_wanted_element_of_pydicoms_own_test_files_is_what_pydicom_reads() -> None:
    compared = 0
    for path in PACKAGED:
        try:
            ours = read_header(blob(path), Limits()).elements
        except InputError:
            continue
        theirs = pydicom.dcmread(path, force=True)
        for tag in tags.VALUES - {tags.TRANSFER_SYNTAX_UID}:
            element = theirs.get_item(tag) if tag in theirs else None
            assert (tag in ours) == (element is not None), (path, hex(tag))
            if element is not None and isinstance(element.value, bytes):
                assert ours[tag] == element.value, (path, hex(tag))
                compared += 1
    assert compared > 1000


@pytest.mark.parametrize("syntax", ["1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2"])
def test_facts_are_the_same_in_implicit_explicit_and_big_endian_files(tmp_path: Path, syntax: str) -> None:
    save(dataset(2), tmp_path / "a", syntax)
    instance = instance_from_header(blob(tmp_path / "a"), read_header(blob(tmp_path / "a"), Limits()))
    assert instance.pixels is not None
    assert (instance.pixels.rows, instance.pixels.columns, instance.modality) == (8, 10, "CT")
    assert instance.series_uid == "1.2.3.2"


def test_elements_inside_other_sequences_are_not_mistaken_for_the_images_own(tmp_path: Path) -> None:
    made = dataset(0)
    other = Dataset()
    other.ImagePositionPatient, other.SOPInstanceUID = [1, 2, 3], "9.9"
    made.SourceImageSequence = [other]
    for undefined in (False, True):
        made["SourceImageSequence"].is_undefined_length = undefined
        save(made, tmp_path / "a")
        elements = read_header(blob(tmp_path / "a"), Limits()).elements
        assert numbers(elements, 0x00200032) == (-10, -20, 30)


def test_a_sequence_of_unknown_representation_is_implicit_inside_and_stepped_over(
    tmp_path: Path, plain: bytes
) -> None:
    inside = b"\x09\x00\x02\x10" + struct.pack("<L", 4) + b"abcd"
    item = b"\xfe\xff\x00\xe0\xff\xff\xff\xff" + inside + b"\xfe\xff\x0d\xe0\0\0\0\0"
    unknown = b"\x09\x00\x01\x10UN\0\0\xff\xff\xff\xff" + item + b"\xfe\xff\xdd\xe0\0\0\0\0"
    at = plain.find(b"\x10\x00\x10\x00PN")
    elements = read_header(written(tmp_path / "a", plain[:at] + unknown + plain[at:]), Limits()).elements
    assert numbers(elements, 0x00200032) == (-10, -20, 30)


def test_an_element_that_stands_twice_with_two_values_is_refused(tmp_path: Path, plain: bytes) -> None:
    at = plain.find(b"\x28\x00\x30\x00DS")
    again = plain[at : at + 8] + b"0.8\\0.75"
    assert len(again) == 16
    with pytest.raises(DamagedError, match=r"it gives element \(0028,0030\) twice, with two values"):
        read_header(written(tmp_path / "twice", plain[:at] + again + plain[at:]), Limits())
    same = plain[:at] + plain[at : at + 8 + plain[at + 6]] + plain[at:]
    assert read_header(written(tmp_path / "same", same), Limits()).elements


SECOND_PIXELS = b"\xe0\x7f\x10\x00OW\0\0\x04\0\0\0\1\2\3\4"
TRAILING_PADDING = b"\xfc\xff\xfc\xffOB\0\0\x04\0\0\0\1\2\3\4"


def test_a_second_set_of_pixels_is_refused_and_padding_is_not(tmp_path: Path, plain: bytes) -> None:
    for number, filled in enumerate((TRAILING_PADDING, b"\0" * 100)):
        header = read_header(written(tmp_path / f"{number}", plain + filled), Limits())
        assert header.pixel_length == 160
    for number, out_of_order in enumerate((SECOND_PIXELS, TRAILING_PADDING + SECOND_PIXELS)):
        with pytest.raises(DamagedError, match=r"element \(7FE0,0010\) follows element .* out of order"):
            read_header(written(tmp_path / f"twice{number}", plain + out_of_order), Limits())


def test_a_second_set_of_deflated_or_compressed_pixels_is_refused(tmp_path: Path, plain: bytes) -> None:
    start = len(plain) - len(plain[132:]) + 12 + struct.unpack_from("<L", plain, 140)[0]
    meta = plain[:start].replace(b"1.2.840.10008.1.2.1\0", b"1.2.840.10008.1.2.1.99")
    meta = meta.replace(b"UI\x14\x001.2.840.10008.1.2.1.99", b"UI\x16\x001.2.840.10008.1.2.1.99")
    packer = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    deflated = meta + packer.compress(plain[start:] + SECOND_PIXELS) + packer.flush()
    with pytest.raises(DamagedError, match="out of order"):
        read_header(written(tmp_path / "deflated", deflated), Limits())
    save(compress(dataset(0, stored=pattern(0, 64, 64)), RLELossless, tmp_path), tmp_path / "rle")
    rle = written(tmp_path / "rle", (tmp_path / "rle").read_bytes() + SECOND_PIXELS)
    with pytest.raises(DamagedError, match="out of order"):
        images_of(instance_from_header(rle, read_header(rle, Limits())))


@pytest.mark.parametrize("keep", [0, 1, 131, 140, 200, 400, 700])
def test_a_file_cut_off_anywhere_in_its_header_is_refused(tmp_path: Path, plain: bytes, keep: int) -> None:
    with pytest.raises((NotDicomError, DamagedError)):
        read_header(written(tmp_path / "cut", plain[:keep]), Limits())


@pytest.mark.parametrize("length", [0xFFFFFFFE, 0x7FFFFFFF, 100_000])
def test_an_element_longer_than_the_file_is_refused(tmp_path: Path, plain: bytes, length: int) -> None:
    at = plain.find(b"\x10\x00\x10\x00PN")
    longer = plain[:at] + b"\x09\x00\x01\x10OB\0\0" + struct.pack("<L", length) + plain[at:]
    with pytest.raises(DamagedError, match="longer than what is left"):
        read_header(written(tmp_path / "long", longer), Limits())


@pytest.mark.parametrize("depth", [40, 5000, 200_000])
def test_sequences_without_end_are_refused_however_deep(tmp_path: Path, plain: bytes, depth: int) -> None:
    with pytest.raises(DamagedError, match="nest deeper than 32"):
        read_header(written(tmp_path / "deep", nested(plain, depth)), Limits())


def test_a_header_beyond_the_limit_is_refused_and_read_when_the_limit_is_raised(
    tmp_path: Path, plain: bytes
) -> None:
    at = plain.find(b"\x10\x00\x10\x00PN")
    large = plain[:at] + b"\x09\x00\x01\x10OB\0\0" + struct.pack("<L", 200_000) + bytes(200_000) + plain[at:]
    file = written(tmp_path / "large", large)
    with pytest.raises(DamagedError, match="its header is too long"):
        read_header(file, Limits(header_bytes=100_000))
    assert 0x00280010 in read_header(file, Limits()).elements


def test_a_document_that_is_larger_than_headers_may_be_is_no_damage(tmp_path: Path) -> None:
    """A PDF, an STL file or contours of 16 MiB were refused by the node, and flagged beside a scan."""
    made = dataset(0)
    for keyword in ("PixelData", "Rows", "Columns"):
        delattr(made, keyword)
    made.EncapsulatedDocument, made.MIMETypeOfEncapsulatedDocument = bytes(200_000), "model/stl"
    save(made, tmp_path / "stl")
    header = read_header(blob(tmp_path / "stl"), Limits(header_bytes=100_000))
    assert (tags.SERIES_INSTANCE_UID in header.elements, header.pixel_tag) == (True, None)
    content = (tmp_path / "stl").read_bytes()
    with pytest.raises(DamagedError, match="longer than what is left"):
        read_header(written(tmp_path / "half", content[:150_000]), Limits(header_bytes=100_000))


@pytest.mark.parametrize("filling", [b"\x09\x00\x01\x10LO\0\0", OPENING[:12] + b"\xfe\xff\x00\xe0\0\0\0\0" * 9])
def test_a_header_of_countless_small_elements_is_refused(tmp_path: Path, plain: bytes, filling: bytes) -> None:
    at = plain.find(b"\x10\x00\x10\x00PN")
    ending = b"\xfe\xff\xdd\xe0\0\0\0\0" if b"SQ" in filling else b""
    file = written(tmp_path / "many", plain[:at] + (filling + ending) * 1000 + plain[at:])
    with pytest.raises(DamagedError, match="its header has more than 900 elements"):
        read_header(file, Limits(header_elements=900))
    assert 0x00280010 in read_header(file, Limits()).elements


def test_a_deflated_file_that_unpacks_without_end_is_refused(tmp_path: Path) -> None:
    save(dataset(0), tmp_path / "a", "1.2.840.10008.1.2.1.99")
    start = len((tmp_path / "a").read_bytes()) - len(deflated_part(blob(tmp_path / "a"), Limits()))
    packer = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    endless = packer.compress(b"\x09\x00\x01\x10LO\0\0" * 4_000_000) + packer.flush()
    file = written(tmp_path / "bomb", (tmp_path / "a").read_bytes()[:start] + endless)
    with pytest.raises(DamagedError, match="its header is too long"):
        read_header(file, Limits(header_bytes=1 << 17))


def test_what_is_not_dicom_is_told_from_what_is_damaged(tmp_path: Path) -> None:
    for content in (b"", b"hello", bytes(5000), b"PK\3\4" + bytes(200), b"\x89PNG\r\n" + bytes(300)):
        with pytest.raises(NotDicomError, match="not a DICOM file"):
            read_header(written(tmp_path / "other", content), Limits())
