import contextlib

import numpy as np
import pydicom
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydicom.encaps import generate_frames

from ronnaplan.ct.files import DamagedError
from ronnaplan.ct.jpeg_lossless import decode_jpeg_lossless
from tests.ct.makers import compress, dataset


@pytest.fixture(scope="module")
def image() -> "np.typing.NDArray[np.uint16]":
    return np.random.default_rng(1).integers(0, 65536, (40, 24)).astype(np.uint16)


@pytest.fixture(scope="module", params=["1.2.840.10008.1.2.4.57", "1.2.840.10008.1.2.4.70"])
def frame(
    request: pytest.FixtureRequest, image: "np.typing.NDArray[np.uint16]", tmp_path_factory: pytest.TempPathFactory
) -> bytes:
    made: pydicom.FileDataset = compress(dataset(0, stored=image), request.param, tmp_path_factory.mktemp("jpeg"))
    return next(generate_frames(made.PixelData, number_of_frames=1))


def test_what_gdcm_encodes_is_decoded_exactly(frame: bytes, image: "np.typing.NDArray[np.uint16]") -> None:
    assert np.array_equal(decode_jpeg_lossless(frame, *image.shape), image)


@pytest.mark.parametrize("predictor", range(1, 8))
@pytest.mark.parametrize("restart_lines", [0, 3])
def test_every_predictor_and_restart_intervals_are_decoded(predictor: int, restart_lines: int) -> None:
    image = np.random.default_rng(predictor).integers(0, 4096, (10, 7))
    assert np.array_equal(decode_jpeg_lossless(encoded(image, predictor, restart_lines), 10, 7), image)


@settings(max_examples=60)
@given(st.data())
def test_a_damaged_stream_is_refused_or_decoded_but_never_raises_otherwise(
    frame: bytes, data: st.DataObject
) -> None:
    at = data.draw(st.integers(0, len(frame) - 1))
    broken = bytearray(frame)
    broken[at] ^= 1 << data.draw(st.integers(0, 7))
    for content in (bytes(broken), frame[:at]):
        with contextlib.suppress(DamagedError):
            assert decode_jpeg_lossless(content, 40, 24).shape == (40, 24)


def test_a_stream_cut_short_is_refused(frame: bytes) -> None:
    for keep in range(0, len(frame) - 2, 97):
        with pytest.raises(DamagedError):
            decode_jpeg_lossless(frame[:keep], 40, 24)


def test_a_scan_with_more_in_it_than_the_pixels_is_refused(frame: bytes) -> None:
    end = frame.rfind(b"\xff\xd9")
    with pytest.raises(DamagedError, match="corrupt"):
        decode_jpeg_lossless(frame[:end] + bytes(20) + frame[end:], 40, 24)


def encoded(image: "np.typing.NDArray[np.int64]", predictor: int, restart_lines: int) -> bytes:
    """Encode 12-bit pixels by the letter of T.81: every category has a 5-bit code, so the table is trivial."""
    rows, columns = image.shape
    table = bytes([0, 0, 0, 0, 0, 17, *[0] * 11, *range(17)])
    head = b"\xff\xd8" + segment(0xC4, table) + segment(0xDD, (restart_lines * columns).to_bytes(2, "big"))
    head += segment(0xC3, bytes([12, 0, rows, 0, columns, 1, 1, 0x11, 0]))
    head += segment(0xDA, bytes([1, 1, 0, predictor, 0, 0]))
    scans = []
    for first in range(0, rows, restart_lines or rows):
        part = image[first : first + (restart_lines or rows)]
        bits = "".join(code(int(part[j, i]) - guess(part, j, i, predictor)) for j, i in np.ndindex(part.shape))
        bits += "1" * (-len(bits) % 8)
        scans.append(int(bits, 2).to_bytes(len(bits) // 8, "big").replace(b"\xff", b"\xff\x00"))
    body = scans[0]
    for number, scan in enumerate(scans[1:]):
        body += bytes([0xFF, 0xD0 + number % 8]) + scan
    return head + body + b"\xff\xd9"


def segment(marker: int, body: bytes) -> bytes:
    return bytes([0xFF, marker]) + (len(body) + 2).to_bytes(2, "big") + body


def code(difference: int) -> str:
    category = abs(difference).bit_length()
    value = difference if difference >= 0 else difference + (1 << category) - 1
    return f"{category:05b}" + (f"{value:0{category}b}" if category else "")


def guess(part: "np.typing.NDArray[np.int64]", j: int, i: int, predictor: int) -> int:
    if i == 0 and j == 0:
        return 1 << 11
    if j == 0:
        return int(part[0, i - 1])
    if i == 0:
        return int(part[j - 1, 0])
    a, b, c = int(part[j, i - 1]), int(part[j - 1, i]), int(part[j - 1, i - 1])
    return [a, b, c, a + b - c, a + ((b - c) >> 1), b + ((a - c) >> 1), (a + b) >> 1][predictor - 1]
