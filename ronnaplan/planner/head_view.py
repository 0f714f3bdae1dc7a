"""The 3-D view of the page: what is in the scene, and its picture, drawn anew only where something changed.

A page that draws the head itself fetches its things, and the whole scan.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from aiohttp import web

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.cuts import Picture, picture_of
from ronnaplan.planner.scene import Scene
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Plan, Trajectory
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.head import HeadParts
from ronnaplan.scene.packed import packed
from ronnaplan.scene.volume import PRESETS, table


class HeadView:
    """Keeps a `Scene` as one page has it. It is opened late, when the cuts are seen."""

    def __init__(self, state: PlannerState) -> None:
        self.state = state
        self.scene: Scene | None = None
        self.parts = HeadParts()
        self.region_places_mm: dict[str, FloatArray] = {}
        self._shown: dict[str, Any] = {}
        self._paths: dict[str, Any] = {}
        self._seen: tuple[Camera, tuple[int, int]] | None = None
        self._picture: Picture | None = None

    def open(self, parts: HeadParts) -> None:
        """Make the scene of what was made of the scan."""
        self.parts, self.scene = parts, Scene(self.state)
        if "skin" in parts.surfaces:
            self.scene.show_surface("skin", parts.surfaces["skin"])
            self.scene.fill()
        for name, body in parts.regions.items():
            if len(body.triangles):
                self.region_places_mm[name] = body.vertices_mm.mean(axis=0).astype(float)

    @property
    def drawn_whole(self) -> dict[str, Any]:
        """How the page draws the scan whole: table, opacity and where it lies; empty where surfaces are drawn."""
        look = self.state.look
        if self.parts.volume is None or not look.preset:
            return {}
        shades = table(PRESETS[look.preset], look.strength)
        least = int(np.flatnonzero(shades[:, 3])[0])
        return {
            **self.parts.volume.shape,
            "table": base64.b64encode(shades.tobytes()).decode(),
            "least": least / 255,
        }

    @property
    def camera(self) -> Camera | None:
        """What the head is seen with, None until the scene is there."""
        return None if self.scene is None else self.scene.camera

    def update(self, plan: Plan) -> None:
        """Have in the scene what is to be seen now, and the trajectories of a ``plan``, once there is one."""
        if self.scene is not None and any((self._update(self.scene), self._update_paths(self.scene, plan))):
            self._seen = None

    def picture(self, shape: tuple[int, int] = (640, 640)) -> Picture | None:
        """Return the picture of ``shape`` = (rows, columns) as the page takes it, None until the scene is there."""
        scene = self.scene
        if scene is None:
            return None
        seen = scene.camera, shape
        if seen != self._seen:
            self._seen = seen
            self._picture = picture_of("jpeg", scene.draw(shape))
        return self._picture

    def _update(self, scene: Scene) -> bool:
        """Show surface, markers and proposals as they are now; tells whether any of them changed."""
        state = self.state
        tracked = (state.case.registration, state.case.outdated)
        layers: dict[str, tuple[Any, Callable[[], None]]] = {
            "surface": ((state.look.surface, state.look.preset), lambda: self._show_surface(scene)),
            "markers": ((state.case.fiducials, state.look.marker), scene.show_markers),
            "regions": (state.look.regions, lambda: scene.show_regions(state.look.regions, self.parts.regions)),
            "tools": (state.following.seen, lambda: scene.show_tools(state.following.seen)),
            "tracker": (tracked, lambda: scene.show_tracker(state.following.ct_from_ots)),
            "robot": (state.case.placement, lambda: scene.show_robot(state.case.placement)),
            "proposals": (state.offers.proposals, lambda: scene.show_proposals(state.offers.proposals)),
            "placement": (state.offers.placement, lambda: scene.show_placement(state.offers.placement)),
        }
        changed = [name for name, (now, _) in layers.items() if not _same(self._shown.get(name, self), now)]
        for name in changed:
            self._shown[name], show = layers[name]
            show()
        return bool(changed)

    def _update_paths(self, scene: Scene, plan: Plan) -> bool:
        """Show the trajectories of a plan; tells whether any of them changed.

        One that is yet to be measured has no tube until it is: to measure many here would hold the pages up.
        """
        case, before, changed = self.state.case, self._paths, False
        self._paths = {}
        for one in plan.trajectories:
            key, known = self._path_key(one), case.surroundings.knows(one, plan, rough=case.dragging)
            drawn = before.pop(one.name, None)
            if drawn not in ((key, True), (key, known)):
                scene.show_path(one, case.surroundings.measures(one, plan, rough=case.dragging) if known else None)
                drawn, changed = (key, known), True
            self._paths[one.name] = drawn
        for name in before:
            scene.hide_path(name)
        return changed or bool(before)

    def _path_key(self, one: Trajectory) -> Any:
        ends = (*one.entry_mm, *one.target_mm)
        # The surroundings themselves: the id() of some that are gone may be that of others.
        return *ends, one.colour, one.instrument, one.electrode, self.state.case.surroundings

    def _show_surface(self, scene: Scene) -> None:
        kind = self.state.look.surface
        if self.state.look.preset:
            scene.hide_surface()
        elif kind in self.parts.surfaces:
            scene.show_surface(kind, self.parts.surfaces[kind])


def head_routes(heads: Callable[[], Iterable[HeadView]]) -> list[web.RouteDef]:
    """Return what is answered of the ``heads`` of all pages: each thing by its key, those that are still shown."""

    async def things(request: web.Request) -> web.Response:
        scenes = [view.scene for view in heads() if view.scene is not None]
        keys = set(request.match_info["keys"].split(","))
        found = {key: one for key in keys for scene in scenes if (one := scene.thing(key)) is not None}
        return web.json_response({key: packed(one) for key, one in found.items()})

    async def volume(_: web.Request) -> web.Response:
        made = next((view.parts.volume for view in heads() if view.parts.volume is not None), None)
        if made is None:
            raise web.HTTPNotFound(text="it is not made yet")
        return web.Response(body=made.packed, content_type="application/octet-stream")

    return [web.get("/things/{keys}", things), web.get("/volume", volume)]


def _same(shown: Any, now: Any) -> bool:
    """Whether a layer is as it was: texts by what they say, all else by being the very same."""
    return shown == now if isinstance(now, tuple) and isinstance(shown, tuple) else shown is now
