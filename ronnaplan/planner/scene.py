"""The 3-D view, drawn by VTK in this process (no graphics hardware, no window) and sent as pictures."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.cuts import JPEG_QUALITY
from ronnaplan.planner.drawing import MARKER_COLOUR
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Measures
from ronnaplan.planning.proposals import Proposals, score_map
from ronnaplan.planning.trajectory import Trajectory

SIZE = (640, 640)
TURN_DEG_PER_PIXEL = 0.4
COLOURS = {"skin": "#d9b8a0", "skull": "#e8e0cf"}
LEAST_RADIUS_MM = 0.4
"""Thinner instruments would not be seen; thicker ones would hide the tube about them."""

NO_GO_COLOUR = "#e53935"
OPACITY = {"skin": 0.55, "skull": 0.8}


class Scene:
    """Keeps the actors; `draw` renders them. All calls belong to one thread."""

    def __init__(self, state: PlannerState) -> None:
        if not os.environ.get("DISPLAY"):
            # VTK would try an X server first and complain on standard error.
            os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
        import pyvista

        self._pv = pyvista
        self.state = state
        plotter: Any = pyvista.Plotter
        self.plotter = plotter(off_screen=True, window_size=list(SIZE), lighting="light kit")
        self.plotter.set_background("#0b0e11")
        low, high = state.bounds_mm
        middle = (low + high) / 2
        self.plotter.camera.focal_point = middle
        self.plotter.camera.position = middle + np.array([-0.6, -1.0, 0.5]) * 1.25 * float((high - low).max())
        self.plotter.camera.up = (0.0, 0.0, 1.0)

    def close(self) -> None:
        """Give the graphics memory back."""
        self.plotter.close()

    def show_surface(self, kind: str, vertices_mm: FloatArray, triangles: NDArray[np.int64]) -> None:
        """Show skin or skull in the place of the other."""
        if len(triangles) == 0:
            self.plotter.remove_actor("surface")
            return
        faces = np.hstack([np.full((len(triangles), 1), 3), triangles]).ravel()
        mesh = self._pv.PolyData(vertices_mm, faces)
        self._add(mesh, "surface", color=COLOURS[kind], opacity=OPACITY[kind], smooth_shading=True, culling="back")

    def show_region(self, name: str, vertices_mm: FloatArray, triangles: NDArray[np.int64]) -> None:
        """Show a no-go region."""
        if len(triangles):
            faces = np.hstack([np.full((len(triangles), 1), 3), triangles]).ravel()
            self._add(self._pv.PolyData(vertices_mm, faces), f"no-go {name}", color=NO_GO_COLOUR, opacity=0.7)

    def show_markers(self) -> None:
        """Show the markers as spheres of their size."""
        found = self.state.fiducials
        if found is None or not found.fiducials:
            self.plotter.remove_actor("markers")
            return
        spheres = [self._pv.Sphere(radius=one.diameter_mm / 2, center=one.center) for one in found.fiducials]
        self._add(self._pv.merge(spheres), "markers", color=MARKER_COLOUR)

    def show_path(self, one: Trajectory, measured: Measures | None) -> None:
        """Show a trajectory, and the tube that it keeps within with a chance of 95 %."""
        line = self._pv.Line(one.entry_mm, one.target_mm).tube(
            radius=max(one.instrument.radius_mm, LEAST_RADIUS_MM)
        )
        ball = self._pv.Sphere(radius=2.0, center=one.target_mm)
        self._add(line + ball, f"path {one.name}", color=one.colour)
        if measured is None or measured.error is None:
            self.plotter.remove_actor(f"tube {one.name}")
            return
        line = self._pv.lines_from_points(one.at_depth(measured.error.depths_mm))
        line["radius"] = measured.error.tube_mm
        tube = line.tube(scalars="radius", absolute=True)
        self._add(tube, f"tube {one.name}", color=one.colour, opacity=0.3, scalars=None)

    def hide_paths(self) -> None:
        """Take all trajectories and tubes away."""
        for name in list(self.plotter.actors):
            if name.startswith(("path ", "tube ")):
                self.plotter.remove_actor(name)

    def hide_path(self, name: str) -> None:
        """Take one trajectory and its tube away."""
        self.plotter.remove_actor(f"path {name}")
        self.plotter.remove_actor(f"tube {name}")

    def show_proposals(self, found: Proposals | None) -> None:
        """Colour the scalp by the score of each entry."""
        if found is None:
            self.plotter.remove_actor("map")
            return
        places, scores, allowed = score_map(found)
        if not allowed.any():
            self.plotter.remove_actor("map")
            return
        cloud = self._pv.PolyData(places[allowed])
        cloud["score"] = scores[allowed]
        self._add(cloud, "map", scalars="score", cmap="viridis", point_size=6, show_scalar_bar=False)

    def show_placement(self, centres_mm: FloatArray) -> None:
        """Show proposed places for markers."""
        spheres = [self._pv.Sphere(radius=5.75, center=centre) for centre in centres_mm]
        self._add(self._pv.merge(spheres), "placement", color="#4fc3f7", opacity=0.8)

    def turn(self, across_pixels: float, down_pixels: float) -> None:
        """Turn the camera about the head."""
        camera = self.plotter.camera
        camera.Azimuth(-TURN_DEG_PER_PIXEL * across_pixels)
        camera.Elevation(TURN_DEG_PER_PIXEL * down_pixels)
        camera.OrthogonalizeViewUp()

    def zoom(self, factor: float) -> None:
        """Come nearer (factor above 1)."""
        self.plotter.camera.Dolly(factor)

    def draw(self) -> bytes:
        """Render; returns a JPEG."""
        import cv2

        self.plotter.renderer.ResetCameraClippingRange()
        self.plotter.render()
        picture = self.plotter.screenshot(return_img=True)
        return bytes(cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])

    def _add(self, mesh: Any, name: str, **options: Any) -> None:
        self.plotter.add_mesh(mesh, name=name, reset_camera=False, render=False, **options)
