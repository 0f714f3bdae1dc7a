"""napari's reader of fiducials.json, registration.json and plan.json. It imports nothing of napari.

World coordinates of the layers are (z, y, x) of LPS, in mm: napari's order of axes.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.documents.fiducials import FORMAT as FIDUCIALS
from ronnaplan.documents.fiducials import read_fiducials
from ronnaplan.documents.files import read_json
from ronnaplan.documents.plan import FORMAT as PLAN
from ronnaplan.documents.plan import read_plan
from ronnaplan.documents.registration import FORMAT as REGISTRATION
from ronnaplan.documents.registration import read_registration
from ronnaplan.errors import RonnaplanError
from ronnaplan.geometry import FloatArray

Features = dict[str, list[Any]]
Layer = tuple[Any, dict[str, Any], str]
"""Data, the layer's arguments, and its kind."""


def get_reader(path: str | list[str]) -> Callable[[str | list[str]], list[Layer]] | None:
    """Return the reader of ``path``, or None for a file that is not ronnaplan's (napari asks so)."""
    paths = [path] if isinstance(path, str) else path
    return read_layers if paths and all(_format(one) in READERS for one in paths) else None


def read_layers(path: str | list[str]) -> list[Layer]:
    """Return the layers of the documents at ``path``."""
    paths = [path] if isinstance(path, str) else path
    return [READERS[str(_format(one))](one) for one in paths]


def _format(path: str) -> str | None:
    if not os.fspath(path).lower().endswith(".json"):
        return None
    try:
        content = read_json(path)
    except RonnaplanError:
        return None
    return str(content.get("format")) if isinstance(content, dict) else None


def _fiducials(path: str) -> Layer:
    found = read_fiducials(path).fiducials
    features: Features = {
        "label": [one.label for one in found],
        "error_mm": [one.error_rms_mm for one in found],
        "flags": [", ".join(one.flags) for one in found],
    }
    return _points(
        [one.center for one in found], "markers", features, max((one.diameter_mm for one in found), default=1)
    )


def _registration(path: str) -> Layer:
    pairs = read_registration(path).pairs
    features: Features = {"label": [pair.ct for pair in pairs], "residual_mm": [pair.residual for pair in pairs]}
    return _points([pair.center for pair in pairs], "registered markers", features, 8.0)


def _points(places: ArrayLike, name: str, features: Features, size: float) -> Layer:
    style = {"size": size, "face_color": "transparent", "border_color": "orange", "text": "label"}
    return _zyx(places), {"name": name, "features": features, **style}, "points"


def _plan(path: str) -> Layer:
    paths = read_plan(path).trajectories
    lines = [_zyx([one.entry_mm, one.target_mm]) for one in paths]
    features = {"name": [one.name for one in paths]}
    style = {"shape_type": "line", "edge_width": 1.5, "edge_color": [one.colour for one in paths], "text": "name"}
    return lines, {"name": "trajectories", "features": features, **style}, "shapes"


def _zyx(places: ArrayLike) -> FloatArray:
    return np.asarray(places, dtype=np.float64).reshape(-1, 3)[:, ::-1]


READERS: dict[str, Callable[[str], Layer]] = {FIDUCIALS: _fiducials, REGISTRATION: _registration, PLAN: _plan}
