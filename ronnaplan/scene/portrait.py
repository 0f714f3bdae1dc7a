"""A head with its markers from one side, as the demo and the report show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.scene.alone import alone
from ronnaplan.scene.camera import VIEW_DEG, Camera
from ronnaplan.scene.field import Field
from ronnaplan.scene.picture import Shades, picture
from ronnaplan.scene.shapes import Body
from ronnaplan.scene.surfaces import SURFACES, surfaces
from ronnaplan.scene.things import Thing, marker, skin
from ronnaplan.scene.vtk import Workshop

FRONTS = np.array([[-0.62, -0.72, 0.28], [0.62, -0.72, 0.28], [-0.5, -0.66, 0.56], [0.5, -0.66, 0.56]])
"""From the head to the eye, LPS: right front, left front, and both from further above."""

LOOK_PIXELS = 200
"""Side of the picture in which it is looked which markers are hidden."""

MARGIN = 1.06
"""What is shown fills the picture but for this."""

CELL_MM, MOST_TRIANGLES = 1.2, 1_000_000
"""Finer than for a browser: a picture is made once."""

SHAPE = (1000, 1000)


@dataclass(frozen=True, eq=False)
class HeadPicture:
    """A picture (H, W, 4), the camera that tells what is where, and which markers (N,) are not behind the head."""

    shades: Shades
    camera: Camera
    seen: NDArray[np.bool_]


def head_picture(
    volume: CTVolume,
    centers_mm: FloatArray,
    diameter_mm: float,
    shape: tuple[int, int] = SHAPE,
    beside: Sequence[Thing] = (),
) -> HeadPicture:
    """Draw skin, markers (N, 3) and what is shown ``beside`` them from that side in front which shows most of them."""
    with Workshop() as workshop:
        head = alone(Field.of(volume, CELL_MM))
        found = surfaces(workshop, head, {"skin": SURFACES["skin"]}, most_triangles=MOST_TRIANGLES)["skin"]
        things = [marker(f"F{n + 1}", center, diameter_mm) for n, center in enumerate(centers_mm)]
        things += beside
        if len(found.triangles):
            things.append(skin(found))
        best: tuple[Camera, NDArray[np.bool_]] | None = None
        for direction in FRONTS:
            camera = filling(things, direction)
            seen = _seen(camera, found, centers_mm, diameter_mm / 2)
            if best is None or seen.sum() > best[1].sum():
                best = camera, seen
        assert best is not None
        return HeadPicture(picture(workshop, things, best[0], shape), *best)


def _seen(camera: Camera, head: Body, centers_mm: FloatArray, radius_mm: float) -> NDArray[np.bool_]:
    """Return which balls (N,) have their middle before the head's surface, or no more than a diameter behind it."""
    shape = (LOOK_PIXELS, LOOK_PIXELS)
    depths = camera.depths(shape)
    if len(head.triangles):
        camera.draw(head, np.ones(3), np.zeros((*shape, 3), dtype=np.float32), depths)
    places = camera.on_screen(centers_mm.reshape(-1, 3))
    column, row = np.clip(((places[:, :2] + 1.0) / 2 * LOOK_PIXELS).astype(int), 0, LOOK_PIXELS - 1).T
    return np.asarray(places[:, 2] - 2 * radius_mm <= depths[row, column])


def filling(things: Sequence[Thing], direction: FloatArray = FRONTS[0]) -> Camera:
    """Return the eye in ``direction`` (3,) from all that is shown, as near as it can see it whole."""
    places = [one.body.vertices_mm for one in things if len(one.body.vertices_mm)] or [np.eye(3, dtype=np.float32)]
    at = np.concatenate(places).astype(np.float64)
    back = direction / np.linalg.norm(direction)
    middle = (at.min(axis=0) + at.max(axis=0)) / 2
    slope = np.tan(np.radians(VIEW_DEG / 2))
    for _ in range(3):  # to be seen whole depends on where the middle is seen, and that on how near the eye is
        axes = Camera(middle + back, middle).axes
        seen = (at - middle) @ axes.T
        away = float((seen[:, 2] + MARGIN * np.abs(seen[:, :2]).max(axis=1) / slope).max())
        shares = seen[:, :2] / (away - seen[:, 2:])
        middle = middle + away * ((shares.min(axis=0) + shares.max(axis=0)) / 2) @ axes[:2]
    return Camera(middle + away * back, middle)


def still_png(
    workshop: Workshop, things: Sequence[Thing], shape: tuple[int, int] = SHAPE, direction: FloatArray = FRONTS[0]
) -> bytes:
    """Return a picture of things, from ``direction`` (3,), that fills ``shape`` = (rows, columns), as a PNG.

    It is clear where nothing is.
    """
    import cv2

    shades = picture(workshop, things, filling(things, direction), shape)
    return bytes(cv2.imencode(".png", np.ascontiguousarray(shades[..., [2, 1, 0, 3]]))[1])
