"""Things as files that other programs open: glTF, STL, VTK's own, or one HTML page that turns in any browser."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Mapping, Sequence
from html import escape
from importlib.resources import files
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.scene.packed import packed, unit_normals
from ronnaplan.scene.portrait import filling
from ronnaplan.scene.shapes import joined
from ronnaplan.scene.things import Thing

MM_IN_M: Final = 1e-3

UPRIGHT: Final = [MM_IN_M, 0, 0, 0, 0, 0, -MM_IN_M, 0, 0, MM_IN_M, 0, 0, 0, 0, 0, 1]
"""LPS millimetres to glTF's metres (left, up, front), column by column."""

FLOATS, NUMBERS = 5126, 5125
VERTICES, INDICES = 34962, 34963
"""glTF's names for kinds of numbers, and for what they are."""

POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""Told to the browser: this page loads nothing."""

PAGE: Final = files("ronnaplan.scene") / "page"

NOTICE: Final = "research software, not a medical device"


class _Buffer:
    """The numbers of a binary glTF one after the other, its views, and what they are."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: NDArray[Any], component: int, kind: str, target: int, **bounds: list[float]) -> int:
        """Add an array (N, ...) of a ``component`` type, for a ``target``; return the number of its accessor."""
        data, view = values.tobytes(), len(self.views)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), "target": target})
        self.data += data
        told = {"componentType": component, "count": len(values), "type": kind}
        self.accessors.append({"bufferView": view, **told, **bounds})
        return view


def gltf(things: Sequence[Thing]) -> bytes:
    """Return a binary glTF 2.0: one node a thing, in LPS mm below a root that stands upright in metres."""
    buffer, meshes, materials = _Buffer(), [], []
    for number, one in enumerate(things):
        places = one.body.vertices_mm.astype("<f4")
        bounds = {"min": places.min(axis=0).tolist(), "max": places.max(axis=0).tolist()}
        attributes = {
            "POSITION": buffer.add(places, FLOATS, "VEC3", VERTICES, **bounds),
            "NORMAL": buffer.add(unit_normals(one).astype("<f4"), FLOATS, "VEC3", VERTICES),
        }
        indices = buffer.add(one.body.triangles.astype("<u4").ravel(), NUMBERS, "SCALAR", INDICES)
        primitive = {"attributes": attributes, "indices": indices, "material": number}
        meshes.append({"name": one.name, "primitives": [primitive]})
        materials.append(_material(one))
    nodes: list[dict[str, Any]] = [{"name": one.name, "mesh": n} for n, one in enumerate(things)]
    root = {"name": "LPS, mm", "matrix": UPRIGHT, "children": list(range(len(things)))}
    document = {
        "asset": {"version": "2.0", "generator": "ronnaplan"},
        "scene": 0,
        "scenes": [{"nodes": [len(things)]}],
        "nodes": [*nodes, root],
        "meshes": meshes,
        "materials": materials,
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    header, body = json.dumps(document).encode(), bytes(buffer.data)
    header += b" " * (-len(header) % 4)
    chunks = struct.pack("<I4s", len(header), b"JSON") + header + struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def stl(things: Sequence[Thing]) -> bytes:
    """Return a binary STL of all that is shown, in LPS mm."""
    body = joined([one.body for one in things])
    corners = body.vertices_mm[body.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    facets = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    facets["normal"], facets["corners"] = normals, corners
    return b"ronnaplan, LPS, mm".ljust(80) + struct.pack("<I", len(facets)) + facets.tobytes()


def vtp(things: Sequence[Thing]) -> bytes:
    """Return VTK's XML poly data in LPS mm, with normals, colours and the number of the thing at each vertex."""
    body = joined([one.body for one in things])
    counts = [len(one.body.vertices_mm) for one in things]
    colours = np.repeat([np.rint(255 * _colour(one)) for one in things], counts, axis=0).astype(np.uint8)
    number = np.repeat(np.arange(len(things)), counts).astype("<i4")
    ends = 3 * np.arange(1, len(body.triangles) + 1)
    names = ", ".join(f"{n} {one.name}" for n, one in enumerate(things))
    text = f"""<?xml version="1.0"?>
<!-- {escape(names).replace("--", "- -")} -->
<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<PolyData><Piece NumberOfPoints="{sum(counts)}" NumberOfPolys="{len(ends)}">
<PointData Normals="normals" Scalars="colours">
{_array("normals", "Float32", body.normals.astype("<f4"), 3)}
{_array("colours", "UInt8", colours, 3)}
{_array("thing", "Int32", number, 1)}
</PointData>
<Points>{_array("places", "Float32", body.vertices_mm.astype("<f4"), 3)}</Points>
<Polys>{_array("connectivity", "Int64", body.triangles.astype("<i8"), 1)}
{_array("offsets", "Int64", ends.astype("<i8"), 1)}</Polys>
</Piece></PolyData></VTKFile>
"""
    return text.encode()


def html(things: Sequence[Thing], title: str, still_png: bytes) -> bytes:
    """Return a page that shows the things in 3-D, and a still where the browser has no WebGL2; it loads nothing."""
    pieces = {
        "POLICY": POLICY,
        "VIEW": view(things, title, still_png),
        "TITLE": escape(title),
        "NOTICE": NOTICE,
        "VIEWER": viewer(),
    }
    return _filled("scene.html", pieces).encode()


def view(things: Sequence[Thing], title: str, still_png: bytes) -> str:
    """Return what stands in a page where things are seen: the still, the canvas for `viewer`, and the things."""
    low = np.min([one.body.vertices_mm.min(axis=0) for one in things], axis=0)
    high = np.max([one.body.vertices_mm.max(axis=0) for one in things], axis=0)
    camera = filling(things)
    back = camera.position_mm - camera.focus_mm
    away = float(np.linalg.norm(back))
    scene = {
        "eye": {"middle": camera.focus_mm.tolist(), "back": (back / away).tolist(), "away": away},
        "low": low.tolist(),
        "size": (high - low).tolist(),
        "things": [packed(one) for one in things],
    }
    pieces = {
        "TITLE": escape(title),
        "STILL": base64.b64encode(still_png).decode(),
        "SCENE": json.dumps(scene).replace("<", "\\u003c"),
    }
    return _filled("view.html", pieces)


def viewer() -> str:
    """Return the script of a page that holds a `view`."""
    return "".join((PAGE / name).read_text(encoding="utf-8") for name in ("viewer.js", "names.js", "export.js"))


def _filled(name: str, pieces: Mapping[str, str]) -> str:
    whole = (PAGE / name).read_text(encoding="utf-8")
    for place, piece in pieces.items():
        whole = whole.replace(f"<!--{place}-->", piece)
    return whole


def _material(one: Thing) -> dict[str, Any]:
    linear = np.power(_colour(one), 2.2).tolist()
    shine = {"baseColorFactor": [*linear, one.opacity], "metallicFactor": 0.0, "roughnessFactor": 0.6}
    clear = {"alphaMode": "BLEND"} if one.opacity < 1.0 else {}
    return {"name": one.name, "pbrMetallicRoughness": shine, **clear}


def _colour(one: Thing) -> NDArray[np.float64]:
    colour: NDArray[np.float64] = np.asarray(one.colour, dtype=np.float64).reshape(-1, 3).mean(axis=0)
    return colour


def _array(name: str, kind: str, values: NDArray[Any], components: int) -> str:
    data = values.tobytes()
    packed = base64.b64encode(struct.pack("<Q", len(data)) + data).decode()
    told = f'type="{kind}" Name="{name}" NumberOfComponents="{components}" format="binary"'
    return f"<DataArray {told}>{packed}</DataArray>"


WRITERS: Final[dict[str, Callable[[Sequence[Thing]], bytes]]] = {"gltf": gltf, "stl": stl, "vtp": vtp}
"""Files of a scene, by the name given to ``--to``; an HTML page needs a still beside it."""
