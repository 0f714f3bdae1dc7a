"""The head of a scan with a result in 3-D, for the result's own picture (`ronnaplan.display.head_in_3d`)."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from ronnaplan.ct import CTVolume
from ronnaplan.ct.volume import WAYS_TO_A_VOLUME
from ronnaplan.errors import check_type
from ronnaplan.extras import require_packages
from ronnaplan.figures import DOUBT_COLOUR, MARKER_COLOUR, Head
from ronnaplan.localization import Fiducials
from ronnaplan.planning import Plan
from ronnaplan.scene.contents import beside, head_things
from ronnaplan.scene.picture import picture
from ronnaplan.scene.portrait import MOST_TRIANGLES, SHAPE, filling, head_picture
from ronnaplan.scene.things import Thing, path, rgb, spread, spread_factor
from ronnaplan.scene.vtk import NEEDS_PYVISTA, Workshop

REACH: Final = 4.0
"""Ellipsoids reach at most so many radii of their markers from the middles, to stand out of them."""

SPREAD_OPACITY: Final = 0.6
"""So that markers are seen through them. They are of a colour that stands out on a page, too."""


def head_with(result: Fiducials | Plan, volume: CTVolume) -> Head:
    """Return the head with markers and the ellipsoids of their errors, or with trajectories.

    Raises `InputError` where pyvista is not installed or VTK cannot be loaded.
    """
    check_type(volume, CTVolume, "the volume", WAYS_TO_A_VOLUME)
    require_packages(*NEEDS_PYVISTA)
    return _with_paths(result, volume) if isinstance(result, Plan) else _with_markers(result, volume)


def _with_markers(found: Fiducials, volume: CTVolume) -> Head:
    diameter_mm = max(found.diameters_mm, default=0.0)
    factor = spread_factor(found.covariances, REACH * diameter_mm) if len(found) else 1
    around = [spread(one.label, one.center_mm, one.covariance_mm2, factor) for one in found]
    veils = [replace(one, colour=rgb(DOUBT_COLOUR), opacity=SPREAD_OPACITY) for one in around]
    head = head_picture(volume, found.centers, diameter_mm, beside=veils)
    names = [one.label if seen else f"{one.label} behind" for one, seen in zip(found, head.seen, strict=True)]
    title = f"95 % ellipsoids of the markers' centers, {factor} times as large" if len(found) else ""
    return Head(
        head.shades, title, names, [MARKER_COLOUR] * len(found), head.camera.on_screen(found.centers)[:, :2]
    )


def _with_paths(plan: Plan, volume: CTVolume) -> Head:
    paths = beside(plan, volume)
    with Workshop() as workshop:
        things: list[Thing] = [thing for one in paths for thing in path(one)]
        things += [one for one in head_things(workshop, volume, MOST_TRIANGLES) if len(one.body.triangles)]
        camera = filling(things)
        shades = picture(workshop, things, camera, SHAPE)
    entries_mm = np.array([one.entry_mm for one in paths]).reshape(-1, 3)
    names, colours = [one.name for one in paths], [one.colour for one in paths]
    return Head(shades, "", names, colours, camera.on_screen(entries_mm)[:, :2])
