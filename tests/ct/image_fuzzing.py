"""NIfTI, NRRD and MetaImage files with a few bytes changed: each is refused, or read as its own header says."""

from __future__ import annotations

import random
import re
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK

from ronnaplan.ct import CTVolume, read_ct
from tests.ct.fuzzing import LIMITS, SLICES, TOLERANCE_MM
from tests.ct.makers import pattern
from tests.fuzz.border import Border, WrongValueError
from tests.fuzz.mutations import ANYWHERE, mutate

SUFFIXES = (".nii", ".nrrd", ".mha")


class ImageBorder(Border):
    """An image file of each format, with one to three changes."""

    inputs_in_tests = 2000

    def __init__(self) -> None:
        self.files = {suffix: _image(suffix) for suffix in SUFFIXES}

    def check_seeds(self, folder: Path) -> None:
        for given in self.files.items():
            assert self.feed(given, folder) == "read"

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        suffix = chance.choice(SUFFIXES)
        content = bytearray(self.files[suffix])
        mutate(content, ANYWHERE, chance)
        return suffix, (suffix, bytes(content))

    def feed(self, given: Any, folder: Path) -> str:
        suffix, content = given
        path = folder / f"image{suffix}"
        path.write_bytes(content)
        return check_image(read_ct(path, limits=LIMITS), path)


def _image(suffix: str) -> bytes:
    image = SimpleITK.GetImageFromArray(np.stack([pattern(k) for k in range(SLICES)]))
    image.SetSpacing((0.75, 0.5, 2.0))
    image.SetOrigin((-10.0, -20.0, 30.0))
    image.SetDirection((0.8, -0.6, 0.0, 0.6, 0.8, 0.0, 0.0, 0.0, 1.0))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"image{suffix}"
        SimpleITK.WriteImage(image, str(path))
        return path.read_bytes()


def check_image(volume: CTVolume, path: Path) -> str:
    """Compare a volume with the affine map in the file's own header, read here by the letter of its format."""
    try:
        lps_from_index = OWN_HEADERS[path.suffix](path.read_bytes())
    except (ValueError, KeyError, IndexError, struct.error):
        return "read, unverified"
    count, rows, columns = volume.voxels_hu.shape
    for k, j, i in [(0, 0, 0), (count - 1, rows - 1, 0), (count - 1, 0, columns - 1)]:
        ours = volume.grid.positions_mm(np.array([k, j, i], dtype=float))
        either = [lps_from_index @ [i, j, number, 1.0] for number in (k, count - 1 - k)]
        if min(np.abs(ours - place).max() for place in either) > TOLERANCE_MM:
            raise WrongValueError(f"voxel {(k, j, i)} at {ours.tolist()}, its header says {either}")
    return "read"


def _nifti(content: bytes) -> Any:
    order = "<" if 1 <= struct.unpack_from("<h", content, 40)[0] <= 7 else ">"
    if struct.unpack_from(order + "h", content, 254)[0] <= 0:
        raise ValueError("the matrix read here is not in force")
    rows = np.array(struct.unpack_from(order + "12f", content, 280), dtype=float).reshape(3, 4)
    return rows * [[-1.0], [-1.0], [1.0]]


def _nrrd(content: bytes) -> Any:
    header = content.split(b"\n\n")[0].decode("latin-1")
    vectors = [[float(x) for x in each.split(",")] for each in re.findall(r"\(([^)]*)\)", header)]
    signs = {"left-posterior-superior": (1, 1, 1), "right-anterior-superior": (-1, -1, 1)}
    found = re.search(r"^space: *(.*)$", header, re.MULTILINE)
    return np.array(vectors).T * np.array(signs[found.group(1).strip() if found else ""])[:, np.newaxis]


def _meta(content: bytes) -> Any:
    lines = [line.split("=", 1) for line in content[:2000].decode("latin-1").split("\n") if "=" in line]
    fields = {key.strip(): value.split() for key, value in lines}
    matrix = np.array(fields["TransformMatrix"], dtype=float).reshape(3, 3).T
    steps = matrix * np.array(fields["ElementSpacing"], dtype=float)
    return np.column_stack([steps, np.array(fields["Offset"], dtype=float)])


OWN_HEADERS: dict[str, Callable[[bytes], Any]] = {".nii": _nifti, ".nrrd": _nrrd, ".mha": _meta}
