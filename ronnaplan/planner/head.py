"""The 3-D view of the page: what is in the scene, and its picture, drawn anew only where something changed."""

from __future__ import annotations

import base64
from collections.abc import Callable
from typing import Any

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.perspective import Eye
from ronnaplan.planner.scene import Scene
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.surfaces import SURFACES_HU, region, surface
from ronnaplan.planning import Trajectory


class HeadView:
    """Keeps a `Scene` as the state has it. It is opened late, for what draws in 3-D takes seconds to load."""

    def __init__(self, state: PlannerState) -> None:
        self.state = state
        self.scene: Scene | None = None
        self.region_places_mm: dict[str, FloatArray] = {}
        self._shown: dict[str, Any] = {}
        self._paths: dict[str, Any] = {}
        self._camera: Any = None
        self._picture = ""

    def open(self) -> None:
        """Make the scene, with the no-go regions in it."""
        self.scene = Scene(self.state)
        for name, mask in self.state.no_go.items():
            vertices, triangles = region(self.state.volume, mask)
            self.scene.show_region(name, vertices, triangles)
            if len(vertices):
                self.region_places_mm[name] = vertices.mean(axis=0)

    def close(self) -> None:
        """Give the graphics memory back."""
        if self.scene is not None:
            self.scene.close()

    @property
    def eye(self) -> Eye:
        """Where the head is seen from."""
        assert self.scene is not None
        camera = self.scene.plotter.camera
        return Eye.looking_at(camera.position, camera.focal_point, camera.up, camera.view_angle)

    def turn(self, across_pixels: float, down_pixels: float) -> None:
        """Turn about the head."""
        if self.scene is not None:
            self.scene.turn(across_pixels, down_pixels)

    def zoom(self, factor: float) -> None:
        """Come nearer (factor above 1)."""
        if self.scene is not None:
            self.scene.zoom(factor)

    def picture(self) -> str:
        """Return the picture as the page takes it, empty until the scene is there."""
        scene = self.scene
        if scene is None:
            return ""
        camera = scene.plotter.camera
        seen = (*camera.position, *camera.focal_point, *camera.up)
        changed = (self._update(scene), self._update_paths(scene), seen != self._camera)
        if any(changed):
            self._camera = seen
            self._picture = f"data:image/jpeg;base64,{base64.b64encode(scene.draw()).decode()}"
        return self._picture

    def _update(self, scene: Scene) -> bool:
        """Show surface, markers and proposals as they are now; tells whether any of them changed."""
        state = self.state
        layers: dict[str, tuple[Any, Callable[[], None]]] = {
            "surface": (state.surface, lambda: self._show_surface(scene)),
            "markers": (state.fiducials, scene.show_markers),
            "proposals": (state.proposals, lambda: scene.show_proposals(state.proposals)),
            "placement": (state.placement, lambda: self._show_placement(scene)),
        }
        changed = [name for name, (now, _) in layers.items() if self._shown.get(name, self) is not now]
        for name in changed:
            self._shown[name], show = layers[name]
            show()
        return bool(changed)

    def _update_paths(self, scene: Scene) -> bool:
        """Show the trajectories as they are now, but for one that is being dragged: the page draws that."""
        state = self.state
        held = state.selected if state.dragging else None
        wanted = {one.name: one for one in state.plan.trajectories if one.name != held}
        keys = {name: self._path_key(one) for name, one in wanted.items()}
        if keys == self._paths:
            return False
        for name in self._paths.keys() - keys.keys():
            scene.hide_path(name)
        for name, one in wanted.items():
            if keys[name] != self._paths.get(name):
                scene.show_path(one, state.judge(one).measures)
        self._paths = keys
        return True

    def _path_key(self, one: Trajectory) -> Any:
        ends = (*one.entry_mm, *one.target_mm)
        return *ends, one.colour, one.instrument, id(self.state.surroundings)

    def _show_surface(self, scene: Scene) -> None:
        kind = self.state.surface
        scene.show_surface(kind, *surface(self.state.volume, SURFACES_HU[kind]))

    def _show_placement(self, scene: Scene) -> None:
        placed = self.state.placement
        if placed is None:
            scene.plotter.remove_actor("placement")
        else:
            scene.show_placement(placed.centres_mm)
