"""What the cohort's benchmark works on: many tiny files, and many small scans as different scanners make them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from phantoms.fast import render_hu
from phantoms.series import SeriesOptions, write_series
from phantoms.stack import SliceStack, axial_stack
from tests.cohort.scans import CENTERS_MM, tiny
from tests.scans import balls

BROKEN_EVERY = 10
FILES_A_SERIES = 250
REACH_MM = 22.0


@dataclass(frozen=True)
class Condition:
    """How a scan is made and written, where it is not as usual."""

    stack: dict[str, Any] = field(default_factory=dict)
    blur_mm: float = 0.5
    noise_hu: float = 10.0
    diameter_mm: float = 11.5
    material: str = "acrylic"
    written: dict[str, Any] = field(default_factory=dict)


CONDITIONS = {
    "usual": Condition(),
    "thin": Condition({"spacing_mm": 0.6}),
    "thick": Condition({"spacing_mm": 3.0}),
    "overlapping": Condition({"spacing_mm": 1.0, "thickness_mm": 2.0}),
    "uneven": Condition({"positions_mm": tuple(np.cumsum(np.where(np.arange(36) % 3, 1.0, 1.7)) - 23.0)}),
    "tilted": Condition({"tilt_deg": 15.0}),
    "large pixels": Condition({"matrix": 96}),
    "soft": Condition(blur_mm=0.8, noise_hu=4.0),
    "bone": Condition(blur_mm=0.3, noise_hu=25.0),
    "low dose": Condition(noise_hu=40.0),
    "metal": Condition(material="titanium"),
    "small balls": Condition({"matrix": 192}, diameter_mm=5.0),
    "JPEG-LS": Condition(written={"transfer_syntax": "jpeg-ls"}),
    "JPEG 2000": Condition(written={"transfer_syntax": "jpeg-2000"}),
    "RLE": Condition(written={"transfer_syntax": "rle"}),
    "deflated": Condition(written={"transfer_syntax": "deflated"}),
    "shuffled": Condition(written={"order": "shuffled", "padding_hu": -2000.0}),
    "no thickness": Condition(written={"tag": "absent"}),
}

DIAMETERS_MM = tuple(sorted({one.diameter_mm for one in CONDITIONS.values()}))


def make_files(root: Path, count: int) -> None:
    """Write so many one-slice files of tiny series, each of `FILES_A_SERIES`, a folder each."""
    one = next(iter(sorted(tiny(root.parent / "pattern", "1000000").iterdir()))).read_bytes()
    for number in range(count):
        series, k = divmod(number, FILES_A_SERIES)
        folder = root / f"{series // 100:03d}" / f"{series:06d}"
        if k == 0:
            folder.mkdir(parents=True)
        # the same length, so that no length in the file changes
        content = one.replace(b"1.2.9.1000000", f"1.2.9.{1_000_000 + series}".encode())
        (folder / f"{k:03d}").write_bytes(content)


def make_series(root: Path, count: int) -> None:
    """Write so many scans of four balls, 64 x 64 x 44 mm, condition by condition with a noise of their own each.

    One in `BROKEN_EVERY` is broken. A folder of a condition holds its scans.
    """
    draws = np.random.default_rng(7)
    for place, (name, condition) in enumerate(CONDITIONS.items()):
        stack = _stack(condition)
        scene = balls(CENTERS_MM, condition.diameter_mm, condition.material)
        clean = render_hu(scene, stack, blur_mm=condition.blur_mm, noise_hu=0.0, seed=1)
        for number in range(place, count, len(CONDITIONS)):
            folder = root / name / f"{number:04d}"
            folder.mkdir(parents=True)
            noisy = clean + condition.noise_hu * draws.standard_normal(clean.shape)
            options = SeriesOptions(seed=number, description=name, **condition.written)
            write_series(folder, np.round(np.clip(noisy, -1024, 3071)).astype(np.int16), stack, options)
            if number % BROKEN_EVERY == BROKEN_EVERY - 1:
                _damage(folder, number // BROKEN_EVERY)


def _stack(condition: Condition) -> SliceStack:
    usual = {
        "start_mm": -REACH_MM,
        "stop_mm": REACH_MM,
        "matrix": 128,
        "field_of_view_mm": 64.0,
        "spacing_mm": 1.0,
    }
    return axial_stack(**{**usual, **condition.stack})


def _damage(folder: Path, kind: int) -> None:
    """Break a series: a slice cut off, slices missing, or nothing but noise."""
    files = sorted(folder.iterdir())
    if kind % 3 == 0:
        files[5].write_bytes(files[5].read_bytes()[:-500])
    elif kind % 3 == 1:
        for path in files[2:]:
            path.unlink()
    else:
        for path in files:
            path.write_bytes(path.read_bytes()[:200])
