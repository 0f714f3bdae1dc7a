"""The 3-D view of the page: what is in the scene, and its picture, drawn anew only where something changed."""

from __future__ import annotations

import base64
from collections.abc import Callable
from typing import Any

import numpy as np
from aiohttp import web

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.scene import Scene
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Trajectory
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.field import Field, of_mask
from ronnaplan.scene.packed import packed
from ronnaplan.scene.shapes import Body
from ronnaplan.scene.surfaces import REGION, surfaces
from ronnaplan.scene.volume import PRESETS, Volume, table

MOST_TRIANGLES = 40_000
"""As many as are drawn again and again while an end is dragged, without a graphics card."""


class HeadView:
    """Keeps a `Scene` as the state has it. It is opened late, when the cuts are seen."""

    def __init__(self, state: PlannerState) -> None:
        self.state = state
        self.scene: Scene | None = None
        self.region_places_mm: dict[str, FloatArray] = {}
        self.wanting = ""
        """Why there are no surfaces, empty where there are."""
        self.volume: Volume | None = None
        self._surfaces: dict[str, Body] = {}
        self._regions: dict[str, Body] = {}
        self._shown: dict[str, Any] = {}
        self._paths: dict[str, Any] = {}
        self._seen: tuple[Camera, tuple[int, int]] | None = None
        self._picture = ""

    def load(self) -> None:
        """Have the surfaces of skin, skull and no-go regions made; takes seconds, and touches no other part."""
        volume = self.state.case.volume
        try:
            field = Field.of(volume)
            self.volume = Volume.of(field)
            self._surfaces = surfaces(field, most_triangles=MOST_TRIANGLES)
            for name, mask in self.state.case.no_go.items():
                region = surfaces(of_mask(volume, mask), {"region": REGION}, outside=0.0)
                self._regions[name] = region["region"]
        except InputError as error:
            self.wanting = str(error)

    def open(self) -> None:
        """Make the scene of what was loaded."""
        self.scene = Scene(self.state)
        if "skin" in self._surfaces:
            self.scene.show_surface("skin", self._surfaces["skin"])
            self.scene.fill()
        for name, body in self._regions.items():
            self.scene.show_region(name, body)
            if len(body.triangles):
                self.region_places_mm[name] = body.vertices_mm.mean(axis=0).astype(float)

    async def serve_thing(self, request: web.Request) -> web.Response:
        """Answer with one thing of the scene."""
        one = self.scene.thing(request.match_info["key"]) if self.scene is not None else None
        if one is None:
            raise web.HTTPNotFound(text="it is no longer shown")
        return web.json_response(packed(one))

    async def serve_volume(self, _: web.Request) -> web.Response:
        """Answer with the whole scan, as the page's graphics card draws it."""
        if self.volume is None:
            raise web.HTTPNotFound(text="it is not made yet")
        return web.Response(body=self.volume.packed, content_type="application/octet-stream")

    @property
    def drawn_whole(self) -> dict[str, Any]:
        """How the page draws the scan whole: table, opacity and where it lies; empty where surfaces are drawn."""
        look = self.state.look
        if self.volume is None or not look.preset:
            return {}
        shades = table(PRESETS[look.preset], look.strength)
        least = int(np.flatnonzero(shades[:, 3])[0])
        return {**self.volume.shape, "table": base64.b64encode(shades.tobytes()).decode(), "least": least / 255}

    @property
    def camera(self) -> Camera | None:
        """What the head is seen with, None until the scene is there."""
        return None if self.scene is None else self.scene.camera

    def update(self) -> None:
        """Have in the scene what is to be seen now, once there is one."""
        if self.scene is not None and any((self._update(self.scene), self._update_paths(self.scene))):
            self._seen = None

    def picture(self, shape: tuple[int, int] = (640, 640)) -> str:
        """Return the picture of ``shape`` = (rows, columns) as the page takes it, empty until the scene is there."""
        scene = self.scene
        if scene is None:
            return ""
        self.update()
        seen = scene.camera, shape
        if seen != self._seen:
            self._seen = seen
            self._picture = f"data:image/jpeg;base64,{base64.b64encode(scene.draw(shape)).decode()}"
        return self._picture

    def _update(self, scene: Scene) -> bool:
        """Show surface, markers and proposals as they are now; tells whether any of them changed."""
        state = self.state
        layers: dict[str, tuple[Any, Callable[[], None]]] = {
            "surface": ((state.look.surface, state.look.preset), lambda: self._show_surface(scene)),
            "markers": (state.case.fiducials, scene.show_markers),
            "robot": (state.case.placement, lambda: scene.show_robot(state.case.placement)),
            "proposals": (state.offers.proposals, lambda: scene.show_proposals(state.offers.proposals)),
            "placement": (state.offers.placement, lambda: scene.show_placement(state.offers.placement)),
        }
        changed = [name for name, (now, _) in layers.items() if not _same(self._shown.get(name, self), now)]
        for name in changed:
            self._shown[name], show = layers[name]
            show()
        return bool(changed)

    def _update_paths(self, scene: Scene) -> bool:
        """Show the trajectories as they are now; tells whether any of them changed."""
        keys = {one.name: self._path_key(one) for one in self.state.case.plan.trajectories}
        changed = keys != self._paths
        for name in self._paths.keys() - keys.keys():
            scene.hide_path(name)
        for one in self.state.case.plan.trajectories:
            if keys[one.name] != self._paths.get(one.name):
                scene.show_path(one, self.state.case.judge(one).measures)
        self._paths = keys
        return changed

    def _path_key(self, one: Trajectory) -> Any:
        ends = (*one.entry_mm, *one.target_mm)
        # The surroundings themselves: the id() of some that are gone may be that of others.
        return *ends, one.colour, one.instrument, one.electrode, self.state.case.surroundings

    def _show_surface(self, scene: Scene) -> None:
        kind = self.state.look.surface
        if self.state.look.preset:
            scene.hide_surface()
        elif kind in self._surfaces:
            scene.show_surface(kind, self._surfaces[kind])


def _same(shown: Any, now: Any) -> bool:
    """Whether a layer is as it was: texts by what they say, all else by being the very same."""
    return shown == now if isinstance(now, tuple) and isinstance(shown, tuple) else shown is now
