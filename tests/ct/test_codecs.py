import base64
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pydicom.data
import pytest
from pydicom.encaps import encapsulate, generate_frames

from ronnaplan.ct import Limits, VolumeFlag, codecs, read_ct
from ronnaplan.ct.codecs import codestream, decode_frame
from ronnaplan.ct.files import DiskFile
from ronnaplan.ct.fragments import frame_fragments
from ronnaplan.ct.header import read_header
from ronnaplan.ct.slices import PixelFormat, instance_from_header
from ronnaplan.errors import InputError
from tests.ct.makers import compress, dataset, save

PLAIN = ["1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2", "1.2.840.10008.1.2.1.99"]
RLE, JPEG_57, JPEG_70 = "1.2.840.10008.1.2.5", "1.2.840.10008.1.2.4.57", "1.2.840.10008.1.2.4.70"
JPEG_LS, JPEG_2000 = "1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.4.90"
HTJ2K = [f"1.2.840.10008.1.2.4.{number}" for number in (201, 202, 203)]
LOSSLESS = [RLE, JPEG_57, JPEG_70, JPEG_LS, JPEG_2000]
NEAR = {"1.2.840.10008.1.2.4.81": 2, "1.2.840.10008.1.2.4.91": 150}
"""Lossy syntaxes -> the largest error that their settings in the maker allow."""


def stored(k: int, signed: bool) -> Any:
    noise = np.random.default_rng(k).integers(0, 50, (64, 64))
    ramp = np.arange(64 * 64).reshape(64, 64) // 4 + 10 * k + noise
    return (ramp - 600).astype(np.int16) if signed else ramp.astype(np.uint16)


def series(folder: Path, syntax: str, signed: bool) -> Path:
    for k in range(3):
        made = dataset(k, stored=stored(k, signed))
        if syntax in PLAIN:
            save(made, folder / str(k), syntax)
        else:
            save(compress(made, syntax, folder), folder / str(k))
    return folder


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("syntax", PLAIN + LOSSLESS)
def test_every_lossless_transfer_syntax_gives_the_very_values(tmp_path: Path, syntax: str, signed: bool) -> None:
    volume = read_ct(series(tmp_path, syntax, signed))
    expected = np.stack([stored(k, signed).astype(np.int64) for k in range(3)]) - 1024
    assert volume.voxels_hu.dtype == np.int16
    assert np.array_equal(volume.voxels_hu, expected)
    assert volume.flags == ()


@pytest.mark.parametrize("syntax", list(NEAR))
def test_lossy_images_are_read_and_flagged(tmp_path: Path, syntax: str) -> None:
    volume = read_ct(series(tmp_path, syntax, signed=False))
    expected = np.stack([stored(k, signed=False).astype(np.int64) for k in range(3)]) - 1024
    assert np.abs(volume.voxels_hu - expected).max() <= NEAR[syntax]
    assert volume.flags == (VolumeFlag.LOSSY,)


@pytest.mark.parametrize(("lossy", "lossless"), list(zip(NEAR, (JPEG_LS, JPEG_2000), strict=True)))
def test_a_stream_that_tells_of_a_loss_is_flagged_whatever_its_syntax_says(
    lossy: str, lossless: str, tmp_path: Path
) -> None:
    series(tmp_path, lossy, signed=False)
    for path in tmp_path.iterdir():
        path.write_bytes(relabelled(path.read_bytes(), lossless))
    assert read_ct(tmp_path).flags == (VolumeFlag.LOSSY,)


def test_lossless_jpeg_that_leaves_bits_out_is_flagged(tmp_path: Path) -> None:
    """As dcmtk's dcmcjpeg does it (``+pt``), which says nothing of it in the header."""
    series(tmp_path, JPEG_57, signed=False)
    assert not read_ct(tmp_path).flags
    for path in tmp_path.iterdir():
        content = path.read_bytes()
        point_transform = content.index(b"\xff\xda\x00\x08\x01") + 9
        path.write_bytes(content[:point_transform] + b"\x01" + content[point_transform + 1 :])
    assert read_ct(tmp_path).flags == (VolumeFlag.LOSSY,)


def test_baseline_jpeg_is_read_and_flagged(tmp_path: Path) -> None:
    smooth = (np.add.outer(np.arange(64), np.arange(64)) + 20).astype(np.uint8)
    for k in range(3):
        save(compress(dataset(k, stored=smooth), "1.2.840.10008.1.2.4.50", tmp_path), tmp_path / str(k))
    volume = read_ct(tmp_path)
    assert np.abs(volume.voxels_hu[0] + 1024 - smooth.astype(int)).max() <= 3
    assert volume.flags == (VolumeFlag.LOSSY,)


def test_an_image_once_compressed_with_loss_is_flagged_though_no_longer_compressed(tmp_path: Path) -> None:
    for k in range(3):
        made = dataset(k)
        made.LossyImageCompression = "01"
        save(made, tmp_path / str(k))
    assert read_ct(tmp_path).flags == (VolumeFlag.LOSSY,)


ROWS, COLUMNS = np.indices((12, 16))
HTJ2K_VALUES = (16 * ROWS * COLUMNS - 7 * ROWS - 1000 + (5 * ROWS + 3 * COLUMNS) % 7).astype(np.int16)
HTJ2K_STREAM = base64.b64decode(
    "/0//UQApQAAAAAAQAAAADAAAAAAAAAAAAAAAEAAAAAwAAAAAAAAAAAABjwEB/1AACAACAAAACf9SAAwAAgABAAEEBEAB/1wAByCIiIiI/2QAFwAB"
    "T3BlbkpQSCBWZXIgMC4yNi4zLv+QAAoAAAAAAM8AAf+TwAAvTs2Hv/hlHz/u8WcmP17yZR0/TvJV/L8DAd/0fx8FtHkAHf67yYDgfANpDqpw4+Tm"
    "UHOOqdxgnnB2GI/gBEbPAJSliDwLK4RjAMYYwDGwAcAALoYAAXSQAAt8czKUEwohzlh2BDviBCa3QEBf6Usi/cnvz2HL5J8qPr4AOqiBKrGHdiIR"
    "G1APYAT0AjADar5gCEALIMSSME4tbDz1abAByfIV6lXKV1ifwtLVIj5OlcEhZT9OLxfaPdJaXgzeAP/Z"
)
"""These values, losslessly, as OpenJPH 0.26.3 wrote them."""


@pytest.mark.parametrize("syntax", HTJ2K)
def test_htj2k_gives_the_very_values(tmp_path: Path, syntax: str) -> None:
    for k in range(3):
        made = dataset(k, stored=HTJ2K_VALUES)
        made.PixelData = encapsulate([HTJ2K_STREAM])
        made["PixelData"].VR, made["PixelData"].is_undefined_length = "OB", True
        save(made, tmp_path / str(k), syntax)
    volume = read_ct(tmp_path)
    assert np.array_equal(volume.voxels_hu[1], HTJ2K_VALUES - 1024)
    assert (VolumeFlag.LOSSY in volume.flags) == (syntax == HTJ2K[-1])


@pytest.mark.parametrize("kept", [-3, -40, 200])
def test_an_htj2k_stream_cut_short_is_refused(kept: int) -> None:
    with pytest.raises(InputError, match="Error decoding the J2K data"):
        decode_frame(HTJ2K_STREAM[:kept] + b"\xff\xd9", replace(pixel_format(12, 16, HTJ2K[0]), is_signed=True))


def pixel_format(rows: int, columns: int, syntax: str) -> PixelFormat:
    return PixelFormat(
        syntax, False, 0x7FE00010, 0, None, 1, rows, columns, 16, 16, False, None, 1, "MONOCHROME2", 15
    )


@pytest.mark.parametrize(
    ("syntax", "bits", "named"),
    [
        ("1.2.840.10008.1.2.4.51", 12, "JPEG extended, 12 bits, which pylibjpeg-libjpeg decodes"),
        ("1.2.840.10008.1.2.4.110", 16, "JPEG XL lossless, which imagecodecs decodes"),
        ("1.2.840.10008.1.2.4.102", 16, "MPEG-4 video, which ffmpeg decodes"),
        ("1.2.3.4", 16, r"1\.2\.3\.4 \(unknown"),
    ],
)
def test_an_unsupported_syntax_is_refused_with_its_name_and_what_would_help(
    tmp_path: Path, syntax: str, bits: int, named: str
) -> None:
    made = dataset(0, stored=stored(0, signed=False))
    made.BitsStored, made.HighBit = bits, bits - 1
    save(compress(made, RLE, tmp_path), tmp_path / "a")
    (tmp_path / "a").write_bytes(relabelled((tmp_path / "a").read_bytes(), syntax))
    with pytest.raises(InputError, match=named):
        read_ct(tmp_path)


@pytest.mark.parametrize(
    ("syntax", "says"),
    [
        (
            "1.2.840.113619.5.2",
            r"\.5\.2 \(unknown; gdcmconv may know it\) is not supported; export it uncompressed",
        ),
        ("1.2.840.10008.1.2.4.80", "should be encapsulated but is not"),
    ],
)
def test_pixels_that_are_not_compressed_are_refused_by_what_is_wrong_with_their_syntax(
    syntax: str, says: str, tmp_path: Path
) -> None:
    """The first, of GE, is no compression: implicit, with big-endian pixels."""
    save(dataset(0), tmp_path / "1")
    (tmp_path / "1").write_bytes(relabelled((tmp_path / "1").read_bytes(), syntax))
    with pytest.raises(InputError, match=says):
        read_ct(tmp_path)


def relabelled(content: bytes, syntax: str) -> bytes:
    """Return a file with another transfer syntax written into its meta information."""
    at = content.find(b"\x02\0\x10\0UI")
    end = at + 8 + content[at + 6]
    value = syntax.encode() + b"\0" * (len(syntax) % 2)
    return content[: at + 6] + bytes([len(value), 0]) + value + content[end:]


@pytest.mark.parametrize("syntax", LOSSLESS)
def test_a_compressed_image_cut_short_is_refused(tmp_path: Path, syntax: str) -> None:
    series(tmp_path, syntax, signed=False)
    content = (tmp_path / "1").read_bytes()
    (tmp_path / "1").write_bytes(content[: len(content) * 3 // 4])
    with pytest.raises(InputError, match="ends within its compressed pixels"):
        read_ct(tmp_path)


@pytest.mark.parametrize("syntax", [JPEG_70, JPEG_LS, JPEG_2000])
def test_two_images_in_a_file_that_declares_one_are_refused(tmp_path: Path, syntax: str) -> None:
    series(tmp_path, syntax, signed=False)
    made, other = pydicom.dcmread(tmp_path / "1"), pydicom.dcmread(tmp_path / "2")
    images = [next(generate_frames(one.PixelData, number_of_frames=1)) for one in (made, other)]
    made.PixelData = encapsulate(images)
    made.save_as(tmp_path / "1", enforce_file_format=True)
    with pytest.raises(
        InputError, match=r"1 of 3 files \(\S+\): it holds several compressed images but declares one"
    ):
        read_ct(tmp_path)


def test_a_stream_that_ends_early_is_refused_in_a_sentence(tmp_path: Path) -> None:
    series(tmp_path, JPEG_2000, signed=False)
    made = pydicom.dcmread(tmp_path / "1")
    frame = next(generate_frames(made.PixelData, number_of_frames=1))
    made.PixelData = encapsulate([frame[: len(frame) * 3 // 4]])
    made.save_as(tmp_path / "1", enforce_file_format=True)
    with pytest.raises(InputError, match="/1 cannot be decoded: pylibjpeg: Error decoding the J2K data"):
        read_ct(tmp_path)


@pytest.mark.parametrize("syntax", [JPEG_57, JPEG_70, JPEG_LS, JPEG_2000])
def test_a_stream_that_declares_another_size_is_refused_before_it_is_decoded(tmp_path: Path, syntax: str) -> None:
    series(tmp_path, syntax, signed=False)
    made = pydicom.dcmread(tmp_path / "1")
    frame = next(generate_frames(made.PixelData, number_of_frames=1))
    assert codestream(frame) == (64, 64, 1, 16, False)
    with pytest.raises(
        InputError, match=r"samples \(64, 64, 1\), its header \(64, 65, 1\); export it uncompressed"
    ):
        decode_frame(frame, pixel_format(64, 65, syntax))


@pytest.mark.parametrize(("syntax", "signed"), [(JPEG_LS, False), (JPEG_2000, False), (JPEG_2000, True)])
def test_values_of_fewer_bits_than_the_header_has_are_refused_where_their_sign_is_doubtful(
    syntax: str, signed: bool, tmp_path: Path
) -> None:
    """3000 was read as -1096, as pydicom reads it, and GDCM does not; what no reader doubts is read."""
    for low, high, is_read in ((0, 2047, True), (-5 if signed else 0, 2047 if signed else 3000, False)):
        values = np.linspace(low, high, 64 * 64).round().astype("i2" if signed else "u2").reshape(64, 64)
        for k in range(3):
            made = dataset(k, stored=values)
            made.BitsStored, made.HighBit = 12, 11
            made = compress(made, syntax, tmp_path)
            made.BitsStored, made.HighBit, made.PixelRepresentation = 16, 15, int(not signed)
            save(made, tmp_path / str(k))
        if is_read:
            assert np.array_equal(read_ct(tmp_path).voxels_hu[1], values.astype(int) - 1024)
            continue
        with pytest.raises(InputError, match=r"values of 12 bits with(out)? a sign, its header of 16"):
            read_ct(tmp_path)


@pytest.mark.parametrize(("syntax", "lowest"), [(JPEG_LS, 0), (JPEG_2000, 0), (JPEG_2000, -2048)])
def test_values_of_fewer_bits_than_the_header_has_are_read_where_both_say_alike_whether_they_have_a_sign(
    syntax: str, lowest: int, tmp_path: Path
) -> None:
    values = np.linspace(lowest, lowest + 4095, 64 * 64).round().astype("i2" if lowest else "u2").reshape(64, 64)
    for k in range(3):
        made = dataset(k, stored=values)
        made.BitsStored, made.HighBit = 12, 11
        made = compress(made, syntax, tmp_path)
        made.BitsStored, made.HighBit = 16, 15
        save(made, tmp_path / str(k))
    assert np.array_equal(read_ct(tmp_path).voxels_hu[1], values.astype(int) - 1024)


@pytest.mark.parametrize("syntax", [JPEG_LS, JPEG_2000, JPEG_57])
def test_values_of_more_bits_than_a_pixel_of_the_header_has_are_refused(syntax: str, tmp_path: Path) -> None:
    """Their upper bits were left out."""
    for k in range(3):
        made = compress(dataset(k, stored=stored(k, signed=False)), syntax, tmp_path)
        made.BitsAllocated, made.BitsStored, made.HighBit = 8, 8, 7
        save(made, tmp_path / str(k))
    with pytest.raises(InputError, match="values of 16 bits, its header has room for 8"):
        read_ct(tmp_path)


def jpeg_ls_frames(folder: Path) -> list[bytes]:
    """Return streams whose last coded byte differs, so that one of them ends in a zero that is data."""
    frames = []
    for k in range(40):
        values = np.random.default_rng(k).integers(0, 3000, (6, 7)).astype(np.uint16)
        made = compress(dataset(k, stored=values), JPEG_LS, folder)
        frames.append(next(generate_frames(made.PixelData, number_of_frames=1)))
    return frames


def test_jpeg_ls_padded_before_its_end_is_read_as_gdcm_reads_it(tmp_path: Path) -> None:
    """As the stream MR1_JLSL of DICOM's working group 4 is: one zero byte before the end marker."""
    for k in range(3):
        made = compress(dataset(k, stored=stored(k, signed=False)), JPEG_LS, tmp_path)
        frame = next(generate_frames(made.PixelData, number_of_frames=1)).rstrip(b"\0")
        made.PixelData = encapsulate([frame[:-2] + b"\0" + frame[-2:]])
        save(made, tmp_path / str(k))
    theirs = pydicom.dcmread(tmp_path / "1")
    theirs.pixel_array_options(decoding_plugin="gdcm")
    assert np.array_equal(theirs.pixel_array, stored(1, signed=False))
    assert np.array_equal(read_ct(tmp_path).voxels_hu[1], theirs.pixel_array.astype(np.int64) - 1024)


def test_zeros_that_belong_to_jpeg_ls_data_are_not_taken_for_padding(tmp_path: Path) -> None:
    pixels = pixel_format(6, 7, JPEG_LS)
    for k, frame in enumerate(jpeg_ls_frames(tmp_path)):
        expected = np.random.default_rng(k).integers(0, 3000, (6, 7))
        end = frame.rfind(b"\xff\xd9")
        for padding in (0, 1, 3, 8):
            assert np.array_equal(decode_frame(frame[:end] + bytes(padding) + frame[end:], pixels), expected)
        with pytest.raises(InputError):
            decode_frame(frame[:end] + bytes(9) + frame[end:], pixels)
        with pytest.raises(InputError):
            decode_frame(frame[: end - 1] + frame[end:], pixels)


def test_jpeg_2000_in_a_jp2_box_is_judged_by_the_stream_that_is_decoded(tmp_path: Path) -> None:
    made = compress(dataset(0, stored=stored(0, signed=False)), JPEG_2000, tmp_path)
    stream = next(generate_frames(made.PixelData, number_of_frames=1))
    header = b"\0\0\0\x0cjP  \r\n\x87\n" + struct.pack(">L4s", 20, b"ftyp") + b"jp2 \0\0\0\0jp2 "
    small = struct.pack(">L4s", 50, b"free") + stream[:42]
    boxed = header + small + struct.pack(">L4s", len(stream) + 8, b"jp2c") + stream
    assert codestream(boxed) == (64, 64, 1, 16, False)
    assert codestream(header + struct.pack(">L4s", 0xFFFFFFFF, b"free") + stream) is None
    assert codestream(b"nonsense" + stream) is None


@pytest.mark.parametrize("syntax", [JPEG_57, JPEG_LS, JPEG_2000, "1.2.840.10008.1.2.4.50"])
@pytest.mark.parametrize("frame", [b"", b"\xff\xd8", b"\xff\xd8\xff\xd9", b"nonsense" * 20])
def test_a_stream_that_declares_no_size_is_refused_before_it_is_decoded(syntax: str, frame: bytes) -> None:
    with pytest.raises(InputError, match="does not declare its size"):
        decode_frame(frame, pixel_format(6, 7, syntax))


@pytest.mark.parametrize(
    "name",
    [
        "693_J2KI.dcm",
        "J2K_pixelrep_mismatch.dcm",
        "JPEG2000.dcm",
        "JPEGLSNearLossless_16.dcm",
        "MR_small_RLE.dcm",
        "MR_small_jp2klossless.dcm",
        "MR_small_jpeg_ls_lossless.dcm",
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning:pydicom")
def test_pydicoms_own_compressed_images_decode_to_what_pydicom_reads(name: str) -> None:
    path = Path(pydicom.data.__file__).parent / "test_files" / name
    blob = DiskFile(str(path), path.stat().st_size)
    pixels = instance_from_header(blob, read_header(blob, Limits())).pixels
    assert pixels is not None
    ((fragment,),) = frame_fragments(blob, pixels)
    assert np.array_equal(decode_frame(blob.read(*fragment), pixels), pydicom.dcmread(path).pixel_array)


@pytest.mark.parametrize(("allocated", "bits"), [(8, 8), (16, 8), (16, 12), (16, 16)])
@pytest.mark.parametrize("signed", [False, True])
def test_jpeg_ls_is_decoded_as_pydicom_decodes_it(allocated: int, bits: int, signed: bool) -> None:
    import jpeg_ls

    drawn = np.random.default_rng(bits).integers(0, 2**bits, size=(20, 30))
    raw = drawn.astype(np.uint8 if bits == 8 else np.uint16).tobytes()
    frame = bytes(jpeg_ls.encode_pixel_data(raw, rows=20, columns=30, samples_per_pixel=1, bits_stored=bits))
    syntax = "1.2.840.10008.1.2.4.80"
    pixels = PixelFormat(
        syntax, False, 0x7FE00010, 0, None, 1, 20, 30, allocated, bits, signed, None, 1, "MONOCHROME2", bits - 1
    )
    ours, theirs = codecs.decode_frame(frame, pixels), codecs._decode_with_pydicom(frame, pixels)
    assert ours.dtype.kind == theirs.dtype.kind
    assert np.array_equal(ours, theirs)
