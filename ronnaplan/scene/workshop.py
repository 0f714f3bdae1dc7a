"""The process in which VTK works: tasks from standard input, an answer each to standard output, to the input's end.

VTK keeps the memory that it took, and ends a process in which no graphics library can be loaded: neither touches the
process that asked.
"""

from __future__ import annotations

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.pipes import receive, send
from ronnaplan.portable import give_way
from ronnaplan.scene.vtk import Arrays

if TYPE_CHECKING:
    from ronnaplan.scene.head import HeadParts

LEAST_SHARE = 0.02
"""Pieces with fewer cells than this share of the largest are loose, and dropped."""

NOTHING = "3-D: nothing in this scan is as dense as skin"

EYE_LIGHTS = (
    ((-0.5, 0.6, 0.9), 0.92, "#fff6ea"),
    ((0.9, 0.1, 0.5), 0.34, "#dfe9ff"),
    ((0.25, 0.7, -0.9), 0.5, "#ffffff"),
)
"""Where the lights stand in the eye's axes, how strong and of what colour: key, fill, and rim from behind."""


def main() -> None:
    """Do what is asked for."""
    give_way()
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow" if sys.platform == "linux" else "")
    threading.Thread(target=_load, daemon=True).start()
    import ronnaplan.scene.head
    import ronnaplan.scene.surfaces
    import ronnaplan.scene.volume  # noqa: F401

    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as out:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        with suppress(EOFError):
            while True:
                task, given = receive(sys.stdin.buffer)
                send(out, TASKS[task](given))


def _load() -> None:
    """Load VTK's Python beside whatever else is done first."""
    with suppress(ImportError):  # told by the task that needs it
        import pyvista  # noqa: F401


def head(given: dict[str, Any]) -> HeadParts:
    """Return what a head is drawn from: as much as can be made here."""
    from ronnaplan.scene.alone import alone
    from ronnaplan.scene.field import Field, of_mask
    from ronnaplan.scene.head import HeadParts
    from ronnaplan.scene.surfaces import REGION, SURFACES, bodies, task
    from ronnaplan.scene.volume import Volume

    scan, most = given["scan"], given["most"]
    field = alone(Field.of(scan))
    whole = Volume.of(field)
    try:
        made = bodies(surfaces(task(field, SURFACES, LOWEST_HU, most)), SURFACES)
        regions = {
            name: bodies(surfaces(task(of_mask(scan, mask), {name: REGION}, 0.0, most)), {name: REGION})[name]
            for name, mask in given["regions"].items()
        }
    except ModuleNotFoundError as error:
        return HeadParts(whole, wanting=f"3-D surfaces need {error.name}; install ronnaplan[scene]")
    except ImportError as error:
        return HeadParts(whole, wanting=f"VTK cannot be loaded ({error}); see docs/planner.md, 3-D")
    drawn = any(len(body.triangles) for body in made.values())
    return HeadParts(whole, made, regions, "" if drawn else NOTHING)


def surfaces(task: Arrays) -> Arrays:
    """Return vertices, normals (V, 3) and triangles (T, 3) of a field's levels, without loose pieces and cavities."""
    found: Arrays = {}
    values = np.pad(task["values"], 1, constant_values=float(task["outside"]))
    origin_mm = task["origin_mm"] - task["cell_mm"]
    one = partial(_surface, values, origin_mm, task)
    with ThreadPoolExecutor() as pool:  # VTK's filters let other threads work meanwhile
        made = list(pool.map(one, task["levels"], task["sealed"]))
    for name, parts in zip(task["names"], made, strict=True):
        found |= {f"{name}/{key}": part for key, part in parts.items()}
    return found


def _surface(
    values: NDArray[np.float32], origin_mm: NDArray[np.float64], task: Arrays, level: float, sealed: bool
) -> Arrays:
    import pyvista

    cleaned = _cleaned(values, level, sealed, float(task["outside"]))
    if not cleaned.max() > level:
        empty = np.empty((0, 3))
        return {"vertices": empty, "normals": empty, "triangles": empty.astype(np.int32)}
    grid = pyvista.ImageData(
        dimensions=cleaned.shape[::-1], spacing=[float(task["cell_mm"])] * 3, origin=origin_mm.tolist()
    )
    grid.point_data["values"] = cleaned.ravel()
    mesh = grid.contour(
        [float(level)], scalars="values", compute_normals=False, compute_scalars=False, method="flying_edges"
    ).triangulate()
    excess = 1.0 - float(task["most_triangles"]) / max(mesh.n_cells, 1)
    if excess > 0.0:
        mesh = mesh.decimate(excess)
    vertices = np.asarray(mesh.points, dtype=np.float64)
    triangles = mesh.regular_faces.astype(np.int32)
    normals = _normals(cleaned, (vertices - origin_mm) / float(task["cell_mm"]))
    return {"vertices": vertices, "normals": normals, "triangles": _outward(vertices, normals, triangles)}


def _cleaned(values: NDArray[np.float32], level: float, sealed: bool, outside: float) -> NDArray[np.float32]:
    """Return the field without loose pieces, and where it is sealed without cavities that no way leads to."""
    from scipy.ndimage import label

    cleaned = values.copy()
    inside = values >= level
    pieces, count = label(inside)
    sizes = np.bincount(pieces.ravel(), minlength=count + 1)
    sizes[0] = 0
    loose = sizes < LEAST_SHARE * sizes.max(initial=1)
    loose[0] = False
    cleaned[loose[pieces]] = outside
    if sealed:
        hollows, _ = label(~inside)
        cleaned[(hollows != hollows[0, 0, 0]) & ~inside] = 2 * level - outside
    return cleaned


def _normals(values: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return outward unit normals (V, 3), x first, from the gradient at ``places`` (V, 3) in cells."""
    from scipy.ndimage import map_coordinates

    at, steps = places[:, ::-1].T, np.eye(3)
    slopes = [
        map_coordinates(values, at - step[:, np.newaxis], order=1, mode="nearest")
        - map_coordinates(values, at + step[:, np.newaxis], order=1, mode="nearest")
        for step in steps[::-1]
    ]
    normals = np.stack(slopes, axis=-1).astype(np.float64)
    unit_normals: NDArray[np.float64] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return unit_normals


def _outward(
    vertices: NDArray[np.float64], normals: NDArray[np.float64], triangles: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Return the triangles so that they turn anticlockwise, seen from outside."""
    a, b, c = (vertices[triangles[:, n]] for n in range(3))
    facing = np.einsum("ij,ij->i", np.cross(b - a, c - a), normals[triangles].sum(axis=1))
    return np.where((facing < 0.0)[:, np.newaxis], triangles[:, ::-1], triangles).astype(np.int32)


def picture(task: Arrays) -> Arrays:
    """Return the picture (H, W, 4) of bodies, with shadows in their hollows; clear where nothing is."""
    import pyvista

    width, height = (int(pixels) for pixels in task["size"])
    plotter = pyvista.Plotter(off_screen=True, window_size=(width, height), lighting="none")
    plotter.ren_win.SetMultiSamples(0)  # with them what is seen through would be lost
    for number in range(int(task["count"])):
        _add(plotter, {key: task[f"{number}/{key}"] for key in ("vertices", "normals", "triangles", "look")})
    _look(plotter, task)
    plotter.enable_depth_peeling(8)
    plotter.enable_ssao(radius=12.0, bias=0.6, kernel_size=32, blur=True)
    plotter.enable_anti_aliasing("ssaa")
    plotter.set_background("black")
    shown = np.asarray(plotter.screenshot(None, transparent_background=True, return_img=True))
    plotter.close()
    share = np.maximum(shown[..., 3:], 1) / 255.0  # at edges the colours are mixed with the black behind them
    shades = np.minimum(shown[..., :3] / share, 255.0)
    return {"picture": np.dstack([shades, shown[..., 3]]).astype(np.uint8)}


def _add(plotter: Any, part: Arrays) -> None:
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(part["vertices"].astype(np.float32), part["triangles"])
    mesh.point_data["Normals"] = part["normals"].astype(np.float32)
    mesh.point_data.active_normals_name = "Normals"
    *colour, opacity, gloss = part["look"].tolist()
    plotter.add_mesh(
        mesh,
        color=colour,
        opacity=opacity,
        smooth_shading=True,
        split_sharp_edges=False,
        ambient=0.16,
        diffuse=0.9,
        specular=gloss,
        specular_power=24.0,
        show_scalar_bar=False,
    )


def _look(plotter: Any, task: Arrays) -> None:
    """Put the eye and the lights where the task has them."""
    import pyvista

    position, focus, axes = task["position_mm"].tolist(), task["focus_mm"].tolist(), task["axes"]
    plotter.camera.position, plotter.camera.focal_point, plotter.camera.up = position, focus, axes[1].tolist()
    plotter.camera.view_angle = float(task["view_deg"])
    plotter.reset_camera_clipping_range()
    for place, strength, colour in EYE_LIGHTS:
        towards = np.asarray(place) @ axes
        light = pyvista.Light(
            position=(np.array(focus) + 1000.0 * towards).tolist(), focal_point=focus, color=colour
        )
        light.positional, light.intensity = False, strength
        plotter.add_light(light)


TASKS = {"head": head, "surfaces": surfaces, "picture": picture}


if __name__ == "__main__":
    main()
