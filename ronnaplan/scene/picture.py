"""A picture of things from one side: by VTK where a graphics library can be loaded, else filled in by OpenCV."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.scene.camera import FURTHEST_MM, Camera
from ronnaplan.scene.shapes import joined
from ronnaplan.scene.things import Thing
from ronnaplan.scene.vtk import Arrays, NoGraphicsError, Workshop

Shades = NDArray[np.uint8]

EMPTY_MM = 0.99 * FURTHEST_MM
"""Where the depth is more, nothing was drawn: OpenCV leaves its own rounding there."""


def picture(workshop: Workshop, things: Sequence[Thing], camera: Camera, shape: tuple[int, int]) -> Shades:
    """Return the picture (H, W, 4), red, green, blue and how much there is, of ``shape`` = (rows, columns)."""
    try:
        return rendered(workshop, things, camera, shape)
    except NoGraphicsError:
        return filled_in(things, camera, shape)


def rendered(workshop: Workshop, things: Sequence[Thing], camera: Camera, shape: tuple[int, int]) -> Shades:
    """Return the picture that VTK makes; raises `NoGraphicsError` where it cannot load a graphics library."""
    task: Arrays = {
        "size": np.array(shape[::-1]),
        "count": np.array(len(things)),
        "position_mm": camera.position_mm,
        "focus_mm": camera.focus_mm,
        "axes": camera.axes,
        "view_deg": np.array(camera.upright_deg(shape)),
    }
    for number, one in enumerate(things):
        task |= {
            f"{number}/vertices": one.body.vertices_mm,
            f"{number}/normals": one.body.normals,
            f"{number}/triangles": one.body.triangles,
            f"{number}/look": np.array([*one.colour, one.opacity, one.gloss]),
        }
    shades: Shades = workshop.arrays("picture", task)["picture"]
    return shades


def filled_in(
    things: Sequence[Thing], camera: Camera, shape: tuple[int, int], background: FloatArray | None = None
) -> Shades:
    """Return the picture that OpenCV makes; what is seen through is laid over all else, in the order given.

    Of things in turn that are seen through alike, as the tubes of many trajectories, the nearest is laid over all else.
    With a ``background`` (3,), 0 to 1, nothing of the picture is clear.
    """
    import cv2

    picture = np.empty((*shape, 3), dtype=np.float32)
    picture[:] = 0.0 if background is None else background
    depths = camera.depths(shape)
    shown = np.zeros(shape, dtype=np.bool_)
    in_order = sorted(things, key=lambda thing: thing.opacity < 1.0)
    for (opacity, screen), those in groupby(in_order, key=lambda thing: (thing.opacity, thing.screen)):
        alike = list(those)
        body, colours = joined([one.body for one in alike]), np.concatenate([_colours(one) for one in alike])
        if opacity == 1.0:
            camera.draw(body, colours, picture, depths)
            continue
        veil, nearer = picture.copy(), depths.copy()
        camera.draw(body, colours, veil, nearer)
        shown |= depths < EMPTY_MM
        if screen:
            cv2.copyTo(veil, (~shown).astype(np.uint8), picture)
        cv2.addWeighted(veil, opacity, picture, 1.0 - opacity, 0.0, dst=picture)
        shown |= nearer < depths
    shown |= (depths < EMPTY_MM) | (background is not None)
    return np.dstack([cv2.convertScaleAbs(picture, alpha=255.0), shown.astype(np.uint8) * np.uint8(255)])


def _colours(one: Thing) -> FloatArray:
    """Return a colour (V, 3) for each vertex of a thing."""
    return np.broadcast_to(one.colour, one.body.vertices_mm.shape)
