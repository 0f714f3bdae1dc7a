"""The picture of a result with its scan shows the head, and does without where that cannot be drawn."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Annotation

from ronnaplan.ct import CTVolume, read_ct
from ronnaplan.errors import FrameMismatchError, UsageError
from ronnaplan.figures import Picture
from ronnaplan.localization import Fiducials, localize
from ronnaplan.planning import Plan, Trajectory
from ronnaplan.scene.picture import Shades
from ronnaplan.scene.vtk import NoGraphicsError, Workshop
from tests.scans import balls, scan, small_stack

FOLDER = Path(__file__).resolve().parents[2] / "data" / "synthetic_ct"


@pytest.fixture(scope="module")
def volume() -> CTVolume:
    return read_ct(FOLDER)


@pytest.fixture(scope="module")
def found(volume: CTVolume) -> Fiducials:
    return localize(volume, diameter_mm=11.5)


@pytest.fixture
def filled_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have pictures filled in, which is quicker than to load VTK's renderer and shows the same."""

    def without(*_: object) -> None:
        raise NoGraphicsError("none here")

    monkeypatch.setattr("ronnaplan.scene.picture.rendered", without)


def names_in_3d(picture: Picture) -> dict[str, Shades]:
    """Return the names on a picture's head, and the colour (3,) at the place of each."""
    (shown,) = picture.axes[0].images
    shades = np.asarray(shown.get_array())
    middle, half = np.array(shades.shape[1::-1]) / 2, min(shades.shape[:2]) / 2
    found = {}
    for name in picture.axes[0].findobj(Annotation):
        column, row = (middle + half * np.array(name.xy) * [1, -1]).astype(int)
        found[name.get_text()] = shades[row, column, :3].astype(int)
    return found


@pytest.mark.usefixtures("shared_workshop", "filled_in")
def test_markers_and_their_ellipsoids_are_shown_on_their_head_in_3d(volume: CTVolume, found: Fiducials) -> None:
    picture = found.plot(volume)
    assert len(picture.axes) == 4
    assert len(found.plot().axes) == 3
    assert picture.png().startswith(b"\x89PNG")
    names = names_in_3d(picture)
    assert list(names) == list(found.labels)
    # Orange, or the blue of the ellipsoid over it; skin is paler, and redder than green.
    assert all(red > 1.5 * blue or green > red for red, green, blue in names.values())
    assert "500 times as large" in picture.axes[0].get_title()
    red, _, blue, shown = np.moveaxis(np.asarray(picture.axes[0].images[0].get_array()).astype(int), -1, 0)
    assert 0.25 < ((shown > 0) & (red > blue)).mean() < 0.8  # skin; silhouettes are gray
    assert 0.0005 < (blue > red + 20).mean() < 0.02  # ellipsoids


@pytest.mark.usefixtures("shared_workshop", "filled_in")
def test_trajectories_are_seen_through_their_head(volume: CTVolume) -> None:
    entry_mm, target_mm = np.array([35.0, -25.0, 78.0]), np.array([15.0, 5.0, 10.0])
    plan = Plan.of_scan(volume)
    for name, start_mm in (("left", entry_mm), ("away", entry_mm + 5000.0)):
        plan = plan.add(Trajectory(name, start_mm, target_mm, volume.frame, colour="#0000ff"))
    picture = plan.plot(volume)
    assert len(picture.axes) == 4
    names = names_in_3d(picture)
    assert list(names) == ["left"]  # with the other nothing would be seen of the head
    assert names["left"][2] > names["left"][0]
    assert (np.asarray(picture.axes[0].images[0].get_array())[..., 3] > 0).mean() > 0.25
    other = scan(balls([(300.0, 0.0, 0.0)]), small_stack())
    with pytest.raises(FrameMismatchError):
        plan.plot(other)
    assert len(Plan.of_scan(other).plot(other).axes) == 4  # nothing is in it


@pytest.mark.usefixtures("shared_workshop")
def test_where_the_head_cannot_be_drawn_there_are_the_three_sides(
    volume: CTVolume, found: Fiducials, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def ended(*_: object) -> None:
        raise NoGraphicsError("VTK cannot be loaded")

    plan = Plan.of_scan(volume)
    with monkeypatch.context() as without_vtk:
        without_vtk.setattr(Workshop, "answer", ended)
        assert len(found.plot(volume).axes) == len(plan.plot(volume).axes) == 3
    monkeypatch.setattr("ronnaplan.extras.find_spec", lambda _: None)
    with caplog.at_level(logging.INFO, "ronnaplan.display"):
        assert len(found.plot(volume).axes) == len(plan.plot(volume).axes) == 3
    assert "ronnaplan[scene]" in caplog.text
    with pytest.raises(UsageError, match="read_ct returns one"):
        found.plot("scan")  # type: ignore[arg-type]
