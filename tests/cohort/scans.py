"""Tiny series to be listed, and a real one to be localized."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydicom.dataset import Dataset
from pydicom.uid import UID

from phantoms.fast import render
from phantoms.series import SeriesOptions
from phantoms.series import write_series as write_phantom
from tests.ct.makers import write_series
from tests.scans import balls, small_stack

SLICES = 4
CENTERS_MM = [(-20.0, -10.0, -12.0), (18.0, -12.0, 4.0), (0.0, 12.0, 10.0), (12.0, 8.0, -8.0)]


def tiny(folder: Path, name: str, *, shift_hu: int = 0, **changes: Any) -> Path:
    """Write a series of four small slices, whose UID ends with ``name``."""

    def change(made: Dataset, k: int) -> None:
        made.SeriesInstanceUID = f"1.2.9.{name}"
        made.SOPInstanceUID = made.file_meta.MediaStorageSOPInstanceUID = UID(f"1.2.9.{name}.{k + 1}")
        made.RescaleIntercept = -1024 + shift_hu
        for keyword, value in changes.items():
            setattr(made, keyword, value)

    return write_series(folder, SLICES, change, prefix=f"{name}-")


def phantom(folder: Path, *, centers_mm: Sequence[tuple[float, float, float]] = CENTERS_MM, seed: int = 1) -> Path:
    """Write a scan of four balls of 11.5 mm."""
    folder.mkdir(parents=True)
    stack = small_stack(matrix=96, spacing_mm=1.5, thickness_mm=1.5)
    images = render(balls(list(centers_mm)), stack, blur_mm=0.5, noise_hu=10.0, seed=seed)
    write_phantom(folder, images, stack, SeriesOptions(seed=seed))
    return folder
