"""Things in few bytes, as the page's viewer (``page/viewer.js``) takes them."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.scene.things import Thing


def packed(one: Thing) -> dict[str, Any]:
    """Return a thing as JSON can hold it: places as shares of its own box in 16 bits, normals and colours in 8."""
    low, high = one.body.vertices_mm.min(axis=0), one.body.vertices_mm.max(axis=0)
    shares = np.rint((one.body.vertices_mm - low) / np.maximum(high - low, 1e-9) * 65535.0).astype("<u2")
    normals = np.rint(127 * unit_normals(one)).astype(np.int8)
    colour = np.asarray(one.colour, dtype=np.float64)
    painted = {} if colour.ndim == 1 else {"paint": _text(_padded(np.rint(255 * colour).astype(np.uint8)))}
    named = {} if one.label_mm is None else {"label": one.label, "labelAt": one.label_mm.round(2).tolist()}
    return {
        "name": one.name,
        "low": low.tolist(),
        "size": (high - low).tolist(),
        "colour": colour.round(4).tolist() if colour.ndim == 1 else [1.0, 1.0, 1.0],
        "opacity": one.opacity,
        "opens": one.screen,
        "places": _text(_padded(shares)),
        "normals": _text(_padded(normals)),
        "triangles": _text(one.body.triangles.astype("<u4")),
        **painted,
        **named,
    }


def unit_normals(one: Thing) -> NDArray[np.float32]:
    """Return the normals (V, 3) with length one, upwards where there is none."""
    lengths = np.linalg.norm(one.body.normals, axis=1, keepdims=True)
    normals: NDArray[np.float32] = np.where(
        lengths > 1e-6, one.body.normals / np.maximum(lengths, 1e-6), [0, 0, 1]
    )
    return normals


def _padded(values: NDArray[Any]) -> NDArray[Any]:
    """Return rows of four numbers for rows of three: graphics cards read those at once."""
    return np.pad(values, ((0, 0), (0, 1)))


def _text(values: NDArray[Any]) -> str:
    return base64.b64encode(values.tobytes()).decode()
