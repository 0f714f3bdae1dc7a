"""The still of the report's head names every trajectory where it can be read."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import Frame
from ronnaplan.planning import Trajectory
from ronnaplan.planning.trajectory import COLOURS
from ronnaplan.report.overview import SHAPE, named_figure
from ronnaplan.scene.camera import Camera

FRAME = Frame("CT", "1.2.3")
CAMERA = Camera(np.array([0.0, -400.0, 0.0]), np.zeros(3))


def path(name: str, x_mm: float, z_mm: float) -> Trajectory:
    """A path into the head from in front."""
    return Trajectory(
        name, np.array([x_mm, -80.0, z_mm]), np.array([x_mm / 2, 0.0, 0.0]), FRAME, colour=COLOURS[0]
    )


def test_no_name_in_the_still_covers_another_nor_leaves_it() -> None:
    paths = [path("left hippocampus", 0, 20), path("LEFT AMYGDALA", 4, 21), path("WWW", 6, 19)]
    paths += [path("a temporal pole at the edge", 100, -40), path("beside", 400, 0)]
    figure = named_figure(np.zeros((*SHAPE, 4), dtype=np.uint8), CAMERA, paths)
    (axes,) = figure.axes
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in axes.texts]
    assert [text.get_text() for text in axes.texts] == [one.name for one in paths[:-1]]
    assert all(box.x0 >= 0 and box.x1 <= SHAPE[1] for box in boxes)
    for number, one in enumerate(boxes):
        assert not any(one.overlaps(other) for other in boxes[:number])
