"""All that the planner knows and can do, without a browser: the views draw this object and call its methods."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ronnaplan.ct import CTVolume
from ronnaplan.documents.agreement import disagreement
from ronnaplan.documents.fiducials import FiducialsDocument, Source, fiducials_document
from ronnaplan.documents.registration import registration_document
from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray, Points, as_points
from ronnaplan.planner import markers
from ronnaplan.planner.cuts import PATH_VIEWS, STANDARD, WINDOWS_HU, Cut, path_axes
from ronnaplan.planner.judgement import Judgement, Labels, Surroundings
from ronnaplan.planner.storage import Look, Storage
from ronnaplan.planning import Limits, Placement, Plan, Proposals, Trajectory, place_markers, propose
from ronnaplan.planning.sampling import Scan
from ronnaplan.planning.sites import PlacementRules, scalp_sites
from ronnaplan.tracking import find_markers, read_recording

LEAST_FIELD_MM, GREATEST_FIELD_MM = 10.0, 1000.0
"""Bounds of the zoom."""

PATH_FIELD_MM = 130.0
"""What the views along a trajectory show."""

COLOURS = ("#e8a33d", "#4fc3f7", "#81c784", "#f06292", "#ba68c8", "#ffd54f")
"""Given to new trajectories in turn."""

ENDS = ("entry", "target")


class PlannerState:
    """One opened case. Every change that matters is written to its files before the method returns."""

    def __init__(
        self, volume: CTVolume, storage: Storage, limits: Limits | None = None, no_go: Labels | None = None
    ) -> None:
        """Open a case; ``no_go`` are masks (K, J, I) of the scan, by name.

        Raises `FrameMismatchError` where a document is of another scan.
        """
        self.volume, self.storage, self.limits = volume, storage, limits or Limits()
        self.no_go = no_go or {}
        self.scan = Scan.of(volume)
        self.plan = storage.read_plan() or Plan.of_scan(volume)
        self.plan.require_scan(volume)
        self.fiducials = storage.read_fiducials()
        if self.fiducials is not None:
            volume.frame.require(self.fiducials.points.frame)
        self.registration = storage.read_registration()
        if self.registration is not None:
            self.registration.require_frame(volume.frame)
        self.crosshair_mm: FloatArray
        self.centre_mm: FloatArray
        self.field_mm: float
        self.readings_mm: Points | None = None
        self.known_pairs: dict[str, str] = {}
        self._before_drag: Plan | None = None
        self._look(storage.read_look(volume.voxel_sha256) or self._first_look())

    # --- looking ---------------------------------------------------------------------------------------------

    def jump(self, place_mm: Sequence[float] | FloatArray) -> None:
        """Put the crosshair at a place (3,) in LPS, kept within the scan."""
        place = as_points([list(place_mm)], "the crosshair")[0]
        low, high = self.bounds_mm
        self.crosshair_mm = np.clip(place, low, high)

    def scroll(self, view: str, steps: float) -> None:
        """Move the crosshair through a standard view by slices of the scan."""
        self._require_view(view, tuple(STANDARD))
        cut = self.cut(view)
        self.jump(self.crosshair_mm + steps * self.step_mm * cut.away)

    def zoom(self, view: str, factor: float, place_mm: FloatArray) -> None:
        """Enlarge (factor above 1) about ``place_mm`` (3,), which stays where it is on the screen."""
        self._require_view(view, tuple(STANDARD))
        field = float(np.clip(self.field_mm / factor, LEAST_FIELD_MM, GREATEST_FIELD_MM))
        cut = self.cut(view)
        across, down, _ = cut.on_screen_mm(place_mm)
        share = 1.0 - field / self.field_mm
        self.centre_mm = self.centre_mm + share * (across * cut.right + down * cut.down)
        self.field_mm = field

    def fit(self) -> None:
        """Show the whole scan."""
        low, high = self.bounds_mm
        self.centre_mm, self.field_mm = (low + high) / 2, float((high - low).max())

    def choose_window(self, name: str) -> None:
        """Choose a window preset."""
        if name not in WINDOWS_HU:
            raise UsageError(f"there is no window {name}; there are {', '.join(WINDOWS_HU)}")
        self.window = name

    def cut(self, view: str) -> Cut:
        """Return the plane that a view shows; a path view needs a selected trajectory."""
        self._require_view(view, (*STANDARD, *PATH_VIEWS))
        if view in PATH_VIEWS:
            return self._path_cut(view)
        right, down = STANDARD[view]
        away = np.cross(right, down)
        centre = self.centre_mm + (self.crosshair_mm - self.centre_mm) @ away * away
        return Cut(right, down, centre, self.field_mm)

    @cached_property
    def bounds_mm(self) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest LPS coordinates (3,) of voxel centres."""
        ends = [[0.0, n - 1.0] for n in self.volume.voxels_hu.shape]
        corners = self.volume.grid.positions_mm(np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 3))
        return corners.min(axis=0), corners.max(axis=0)

    @property
    def step_mm(self) -> float:
        """One step of scrolling: the usual gap between slices."""
        gaps = self.volume.grid.spacings_mm
        return float(np.median(gaps)) if gaps.size else 1.0

    # --- markers ---------------------------------------------------------------------------------------------

    def find_markers(self, diameter_mm: float) -> FiducialsDocument:
        """Look for markers of another diameter; changes nothing yet."""
        from ronnaplan.localization import localize

        return fiducials_document(localize(self.volume, diameter_mm=diameter_mm))

    def replace_markers(self, found: FiducialsDocument) -> None:
        """Put other markers in the place of those there were."""
        self._change_fiducials(found)

    def reject_marker(self, label: str) -> None:
        """Turn a marker down."""
        self._change_fiducials(markers.reject(self._found, label))

    def accept_marker(self, index: int) -> None:
        """Take the ``index``-th rejected candidate back, if it was a person who turned it down."""
        self._change_fiducials(markers.accept(self._found, index))

    def rename_marker(self, label: str, new: str) -> None:
        """Give a marker another label."""
        self._change_fiducials(markers.rename(self._found, label, new))

    def jump_to_marker(self, label: str) -> None:
        """Put the crosshair at a marker's centre."""
        self.jump(markers.named(self._found, label).center)

    # --- trajectories ----------------------------------------------------------------------------------------

    def add_trajectory(self, entry_mm: FloatArray, target_mm: FloatArray, name: str | None = None) -> str:
        """Add a trajectory and select it; returns its name."""
        taken = {one.name for one in self.plan.trajectories}
        free = next(f"T{n}" for n in range(1, len(taken) + 2) if f"T{n}" not in taken)
        colour = COLOURS[len(taken) % len(COLOURS)]
        added = Trajectory(name or free, entry_mm, target_mm, self.plan.frame, colour=colour)
        self._change_plan(self.plan.add(added))
        self.select(added.name)
        return added.name

    def select(self, name: str | None) -> None:
        """Select a trajectory, or none."""
        self.selected = None if name is None else self.plan.trajectory(name).name
        self.save_look()

    def edit(self, name: str, /, **changes: Any) -> None:
        """Change fields of a trajectory in one step that can be undone; a locked one is refused."""
        self._change_plan(self.plan.edit(name, **changes))

    def begin_drag(self, name: str) -> None:
        """Begin to move a trajectory with the mouse; a locked one is refused."""
        self.plan.edit(name)
        self._before_drag = self.plan

    def drag(self, name: str, end: str, place_mm: FloatArray) -> None:
        """Move one end of a trajectory; the whole drag is one step that can be undone."""
        if end not in ENDS:
            raise UsageError(f"a trajectory has no end {end}; it has entry and target")
        if self._before_drag is None:
            self.begin_drag(name)
        assert self._before_drag is not None
        self.plan = self._before_drag.edit(name, **{f"{end}_mm": place_mm})

    def end_drag(self) -> None:
        """Let go: what was dragged is written."""
        if self._before_drag is not None:
            self._before_drag = None
            self._change_plan(self.plan)

    @property
    def dragging(self) -> bool:
        """Whether an end is being dragged just now."""
        return self._before_drag is not None

    def remove(self, name: str) -> None:
        """Remove a trajectory; a locked one is refused."""
        self._change_plan(self.plan.remove(name))

    def lock(self, name: str, locked: bool) -> None:
        """Lock a trajectory against change, or unlock it."""
        self._change_plan(self.plan.lock(name, locked))

    def undo(self) -> None:
        """Take the last change of the plan back."""
        self._change_plan(self.plan.undo())

    def redo(self) -> None:
        """Make the change again that was taken back last."""
        self._change_plan(self.plan.redo())

    @property
    def chosen(self) -> Trajectory | None:
        """The selected trajectory."""
        return next((one for one in self.plan.trajectories if one.name == self.selected), None)

    @cached_property
    def surroundings(self) -> Surroundings:
        """The head with all that a trajectory is measured against; renewed when the markers change."""
        return Surroundings(self.volume, self.fiducials, self.no_go)

    def judge(self, trajectory: Trajectory) -> Judgement:
        """Return measures, verdicts and expected error of a trajectory as it is now, or why there are none."""
        return self.surroundings.judge(trajectory, self.plan, self.limits)

    def propose(self, name: str) -> Proposals:
        """Score every way to the target of a trajectory; changes nothing."""
        path, around = self.plan.trajectory(name), self.surroundings
        others = [one for one in self.plan.trajectories if one.name != name]
        return propose(
            path.target_mm,
            around.head,
            self.limits,
            name=name,
            instrument=path.instrument,
            obstacles=around.obstacles,
            others=others,
            pose_mm2=around.pose_mm2,
        )

    def propose_markers(self, count: int) -> Placement:
        """Propose places for ``count`` markers that make the expected error at all targets least."""
        paths = self.plan.trajectories
        return place_markers(
            scalp_sites(self.surroundings.head),
            [one.target_mm for one in paths],
            count,
            PlacementRules(),
            [one.entry_mm for one in paths],
        )

    # --- registration ----------------------------------------------------------------------------------------

    def load_readings(self, name: str) -> None:
        """Register with the readings file ``name`` of the case's folder."""
        self.register(find_markers(read_recording(self.storage.readings_path(name))).points)

    def register(self, readings_mm: Points) -> None:
        """Register the markers with a tracker's readings; a refused pairing is kept with its rivals."""
        self.readings_mm, self.known_pairs = readings_mm, {}
        self._register()

    def point_at(self, label: str, reading: str) -> None:
        """Say which reading a marker is, and register again."""
        markers.named(self._found, label)
        self.known_pairs[label] = reading
        self._register()

    def expected_errors_mm(self) -> dict[str, float]:
        """Return the expected error (RMS) of the registration at every end of every trajectory."""
        found = self.registration
        if found is None or found.ots_from_ct is None or self.outdated or not self.plan.trajectories:
            return {}
        places = self._planned
        covariances = found.pose.point_covariances(places.positions_mm)
        rms = np.sqrt(np.trace(covariances, axis1=-2, axis2=-1))
        return dict(zip(places.labels, rms.tolist(), strict=True))

    @property
    def outdated(self) -> str | None:
        """Why the registration no longer holds for the markers as they are now, None where it does."""
        if self.registration is None or self.fiducials is None:
            return None
        return disagreement(self.fiducials, self.registration)

    def _register(self) -> None:
        from ronnaplan.registration.markers import register_markers

        if self.readings_mm is None:
            raise UsageError("no readings are loaded; choose a readings file first")
        found = register_markers(self._found.points, self.readings_mm, known_pairs=tuple(self.known_pairs.items()))
        source = Source.model_validate(self._found.source.model_dump())
        self.registration = registration_document(found, source, self._planned)
        self.storage.write_document(self.registration)

    @property
    def _planned(self) -> Points:
        paths = self.plan.trajectories
        places = np.array([place for one in paths for place in (one.entry_mm, one.target_mm)]).reshape(-1, 3)
        labels = tuple(f"{one.name} {end}" for one in paths for end in ENDS)
        return Points(places, np.zeros((len(places), 3, 3)), labels, self.plan.frame)

    # --- keeping ---------------------------------------------------------------------------------------------

    def save_look(self) -> None:
        """Write where one is looking, to find it again."""
        self.storage.write_look(
            Look(
                voxel_sha256=self.volume.voxel_sha256,
                crosshair=tuple(self.crosshair_mm),
                centre=tuple(self.centre_mm),
                field_mm=self.field_mm,
                window=self.window,
                selected=self.selected,
            )
        )

    def _change_plan(self, plan: Plan) -> None:
        self.plan = plan
        if self.chosen is None:
            self.selected = plan.trajectories[-1].name if plan.trajectories else None
        self.storage.write_plan(plan)

    def _change_fiducials(self, found: FiducialsDocument) -> None:
        self.fiducials = found
        self.__dict__.pop("surroundings", None)
        self.storage.write_document(found)

    @property
    def _found(self) -> FiducialsDocument:
        if self.fiducials is None:
            raise UsageError("no markers are known; localize them first")
        return self.fiducials

    def _first_look(self) -> Look:
        low, high = self.bounds_mm
        middle = tuple((low + high) / 2)
        field = float((high - low).max())
        return Look(voxel_sha256="", crosshair=middle, centre=middle, field_mm=field, window="bone")

    def _look(self, look: Look) -> None:
        self.crosshair_mm = np.array(look.crosshair)
        self.centre_mm = np.array(look.centre)
        self.field_mm = look.field_mm
        self.window = look.window if look.window in WINDOWS_HU else "bone"
        self.selected = look.selected
        if self.chosen is None and self.plan.trajectories:
            self.selected = self.plan.trajectories[0].name

    def _path_cut(self, view: str) -> Cut:
        if self.chosen is None:
            raise UsageError("no trajectory is selected; select one")
        # While an end is dragged the view stays where it was, or it would slip from under the pointer.
        path = (self._before_drag or self.plan).trajectory(self.chosen.name)
        right, down = path_axes(view, path)
        field = max(PATH_FIELD_MM, path.length_mm + 30.0)
        if view == "inline":
            return Cut(right, down, path.at_depth(np.array(path.length_mm / 2)), field)
        depth = np.clip((self.crosshair_mm - path.entry_mm) @ path.inward, 0.0, path.length_mm)
        return Cut(right, down, path.at_depth(depth), field / 2)

    @staticmethod
    def _require_view(view: str, known: Sequence[str]) -> None:
        if view not in known:
            raise UsageError(f"there is no view {view} here; there are {', '.join(known)}")
