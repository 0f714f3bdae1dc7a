"""Pairs of camera images on the disk: a folder with ``left`` and ``right``, one image of a frame in either."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.robot.stereo.circles import Image
from ronnaplan.text import whole_number
from ronnaplan.untrusted import read_whole

LARGEST_BYTES = 1 << 28
"""Of an image's file."""
ENDINGS = (".png", ".tif", ".tiff", ".bmp", ".pgm")
"""Formats without loss: the blocks of the others shift edges."""
MOST_PAIRS = 1000
"""Images in the folder of one camera."""

ImagePair = tuple[Image, Image]


def read_pairs(folder: str | Path) -> dict[int, ImagePair]:
    """Return the grey images (rows, columns) of the left and the right camera by the number of their frame, in order.

    A file's name is the number of its frame (``007.png``). Raises `InputError` for names that are none, frames that one
    camera lacks, files that are no grey images, and images of one moment under two numbers.
    """
    sides = [_numbered(Path(folder) / side) for side in ("left", "right")]
    alone = sorted(set(sides[0]) ^ set(sides[1]))
    if alone:
        raise InputError(f"{folder} shows frame {alone[0]} with one camera only; expected an image of both")
    pairs = {number: (read_image(sides[0][number]), read_image(sides[1][number])) for number in sorted(sides[0])}
    _require_moments(folder, pairs)
    return pairs


def _require_moments(folder: str | Path, pairs: dict[int, ImagePair]) -> None:
    """Raise `InputError` where a pair is another one to the last pixel: no camera is without noise, so it is a copy."""
    told: dict[tuple[bytes, bytes], int] = {}
    for number, (left, right) in pairs.items():
        first = told.setdefault((sha256(left.tobytes()).digest(), sha256(right.tobytes()).digest()), number)
        if first != number:
            raise InputError(
                f"{folder} shows the same images as frames {first} and {number}, to the last pixel; expected images of "
                "as many moments, so leave copies out"
            )


def read_image(path: Path) -> Image:
    """Return the grey image (rows, columns) at ``path``; raises `InputError` for anything else."""
    import cv2

    content = np.frombuffer(read_whole(path, LARGEST_BYTES, expected="an image"), dtype=np.uint8)
    try:
        image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    except cv2.error:  # of one that says of itself that it has more pixels than any
        image = None
    if image is None:
        raise InputError(f"{path} is no image, or damaged; expected grey values as {', '.join(ENDINGS)}")
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"{path} has the shape {image.shape} of {image.dtype}; expected one grey value of 8 or 16 bits a pixel"
        )
    return np.asarray(image, dtype=np.float64) if image.dtype == np.uint16 else np.asarray(image, dtype=np.uint8)


def _numbered(folder: Path) -> dict[int, Path]:
    """Return the images in ``folder`` by the number that is their name."""
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; expected the images of one camera there")
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in ENDINGS:
            continue
        number = whole_number(path.stem)
        if number is None or number < 0:
            raise InputError(f"{path} is not named by the number of its frame; expected a name such as 007.png")
        if number in found:
            raise InputError(f"{path} and {found[number]} are both frame {number}; expected one image a frame")
        found[number] = path
    if not 0 < len(found) <= MOST_PAIRS:
        raise InputError(f"{folder} holds {len(found)} images; expected 1 to {MOST_PAIRS} as {', '.join(ENDINGS)}")
    return found
