"""The still of the report's head names every trajectory where it can be read."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from ronnaplan.geometry import Frame
from ronnaplan.planning import Trajectory
from ronnaplan.planning.trajectory import COLOURS
from ronnaplan.report.overview import SHAPE, named_figure
from ronnaplan.report.picture import png
from ronnaplan.scene.camera import Camera

FRAME = Frame("CT", "1.2.3")
CAMERA = Camera(np.array([0.0, -400.0, 0.0]), np.zeros(3))


def path(name: str, x_mm: float, z_mm: float) -> Trajectory:
    """A path into the head from in front."""
    return Trajectory(
        name, np.array([x_mm, -80.0, z_mm]), np.array([x_mm / 2, 0.0, 0.0]), FRAME, colour=COLOURS[0]
    )


@pytest.mark.parametrize("name", ["$\\frac$", "a $x^2$ b", "\u6d77\u99ac", "\U00012000"])
def test_a_name_is_drawn_by_the_letter(
    name: str, recwarn: pytest.WarningsRecorder, caplog: pytest.LogCaptureFixture
) -> None:
    """A name is no formula, as one between dollar signs is to matplotlib, and no font is warned of."""
    figure = named_figure(np.zeros((*SHAPE, 4), dtype=np.uint8), CAMERA, [path(name, 0, 20)])
    assert png(figure).startswith(b"\x89PNG")
    (text,) = figure.axes[0].texts
    assert text.get_text() in (name, "\u25a1" * len(name))
    assert not recwarn.list
    assert not caplog.records


def test_a_name_that_no_font_has_is_a_box_and_the_rest_stays() -> None:
    figure = named_figure(np.zeros((*SHAPE, 4), dtype=np.uint8), CAMERA, [path("left \U0001e900", 0, 20)])
    png(figure)
    assert figure.axes[0].texts[0].get_text() == "left \u25a1"


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


def test_ticks_named_by_letters_that_no_font_has_are_boxed_where_they_are_drawn(
    recwarn: pytest.WarningsRecorder,
) -> None:
    """An axis sets the texts of its ticks again at each drawing."""
    figure = Figure()
    axes = figure.subplots()
    axes.set_yticks([1, 2], ["left \U0001e900", "right"])
    png(figure)
    assert [text.get_text() for text in axes.get_yticklabels()] == ["left \u25a1", "right"]
    assert [text.get_text() for text in axes.get_xticklabels()][:2] == ["0.0", "0.2"]
    assert not recwarn.list
