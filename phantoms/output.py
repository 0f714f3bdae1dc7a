"""A scanned phantom on disk: the DICOM series and ``truth.json`` beside each other, whole or not at all."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantoms.errors import PhantomError
from phantoms.scene import Marker, Scene
from phantoms.series import SeriesOptions, write_series
from phantoms.stack import SliceStack

TRUTH_NAME = "truth.json"
TRUTH_FORMAT = "phantoms.truth"


def truth(scene: Scene, stack: SliceStack, **scan: object) -> dict[str, Any]:
    """Return the contents of ``truth.json``: true centers (LPS mm), diameters, materials, and the scan."""
    return {
        "format": TRUTH_FORMAT,
        "version": 1,
        "coordinate_system": "LPS",
        "unit": "mm",
        "scene": scene.name,
        "markers": [
            {
                "label": marker.label,
                "center": [round(float(v), 6) for v in marker.center_mm],
                "diameter_mm": marker.diameter_mm,
                "stated_diameter_mm": marker.stated_diameter_mm or marker.diameter_mm,
                "wall_mm": marker.wall_mm,
                "out_of_round": marker.out_of_round,
                "covering": marker.covering,
                "material": marker.material,
                "whole_in_scan": stack.holds_whole(marker.center_mm, marker.diameter_mm),
                **_path(marker),
            }
            for marker in scene.markers
        ],
        "decoys": [
            {"kind": decoy.kind, "center": [round(float(v), 6) for v in decoy.center_mm]} for decoy in scene.decoys
        ],
        "scan": {
            "slices": len(stack),
            "matrix": [stack.rows, stack.columns],
            "pixel_mm": stack.pixel_mm,
            "thickness_mm": stack.thickness_mm,
            "tilt_deg": stack.tilt_deg,
            **scan,
        },
    }


def _path(marker: Marker) -> dict[str, Any]:
    """Return the path of a marker that moved: time and place, and the place in the middle of that time."""
    if marker.path is None:
        return {}
    steps = np.round(marker.path, 6)
    return {"path": steps.tolist(), "center_at_mid_scan": steps[len(steps) // 2, 1:].tolist()}


def write_phantom(
    folder: str | Path,
    scene: Scene,
    stack: SliceStack,
    images: NDArray[np.int16],
    options: SeriesOptions | None = None,
    **scan: object,
) -> None:
    """Write series and truth to ``folder``; what an earlier call wrote there is replaced.

    Everything is first written beside ``folder`` and then renamed. Raises `PhantomError` when ``folder`` exists
    and holds anything but an earlier phantom.
    """
    target = Path(folder).absolute()
    check_target(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent) as beside:
            fresh = Path(beside) / "new"
            fresh.mkdir()
            write_series(fresh, images, stack, options)
            text = json.dumps(truth(scene, stack, **scan), indent=2)
            (fresh / TRUTH_NAME).write_text(text + "\n", encoding="utf-8")
            _exchange(target, fresh, Path(beside) / "old")
    except OSError as error:
        cause = (
            error.__cause__ if isinstance(error.__cause__, OSError) else error
        )  # pydicom tells a whole traceback
        raise PhantomError(
            f"cannot write to {target}: {cause.strerror or cause}; make room, or choose a folder you may write to"
        ) from error


def _exchange(target: Path, fresh: Path, old: Path) -> None:
    """Put ``fresh`` in the place of ``target``; if that fails, what was there is put back."""
    if target.exists():
        target.rename(old)
    try:
        fresh.rename(target)
    except OSError:
        if old.exists():
            old.rename(target)
        raise


def check_target(target: Path) -> None:
    """Raise `PhantomError` when ``target`` holds anything but an earlier phantom."""
    if not target.exists():
        return
    if not target.is_dir():
        raise PhantomError(f"{target} is a file; expected a folder that is new, empty or an earlier phantom")
    names = [path.name for path in target.iterdir()]
    if names and not _is_phantom(target / TRUTH_NAME):
        raise PhantomError(f"{target} holds {len(names)} files that are no phantom's; choose a new folder")


def _is_phantom(path: Path) -> bool:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(document, dict) and document.get("format") == TRUTH_FORMAT
