"""Where a person looks in a case: crosshair, cuts, zoom, window and what is selected."""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Sequence

import numpy as np

from ronnaplan.case.edits import OpenCase
from ronnaplan.errors import RonnaplanError, UsageError
from ronnaplan.geometry import FloatArray, as_point
from ronnaplan.planner.cuts import ACROSS, PATH_VIEWS, STANDARD, WINDOWS_HU, path_axes
from ronnaplan.planner.head_look import HeadLooking
from ronnaplan.planner.regions import Regions, changed
from ronnaplan.planner.second import Blend
from ronnaplan.planner.storage import LAYOUTS, Look, PlacedImage, ShownRegion, Storage
from ronnaplan.planning import Plan, Trajectory
from ronnaplan.scene.cut import Cut

LEAST_FIELD_MM, GREATEST_FIELD_MM = 10.0, 1000.0
"""Bounds of the zoom."""

PATH_FIELD_MM = 130.0
"""What the views along a trajectory show."""

SEEN_SHARE = 0.45
"""What is no further from the middle of a cut, in what it shows, is in view."""

OWN_WINDOW = "own"
"""The name of a window that is none of the presets."""

LOWEST_HU, GREATEST_HU, NARROWEST_HU = -10_000.0, 100_000.0, 2.0
"""Bounds of a window."""


class Looking(HeadLooking):
    """Where one person looks in an open case."""

    def __init__(self, case: OpenCase, storage: Storage) -> None:
        """Look where the case was left."""
        self.case, self.storage = case, storage
        super().__init__(case.volume)
        self.center_mm: FloatArray
        self.field_mm: float
        self.window: str
        self.window_hu: tuple[float, float]
        self.layout: str
        self.marker: str | None = None
        self.begun_mm: FloatArray | None = None
        """The entry of a trajectory whose target is still to be clicked."""
        self.measured_mm: list[FloatArray] = []
        """The points of a distance or an angle whose last is still to be clicked."""
        self.blend = Blend()
        """How a second image is shown over the cuts."""
        self.regions: Regions = {}
        """How each region is shown."""
        self.chosen_regions: dict[str, ShownRegion] = {}
        """What was chosen last of how regions are shown, by name, of those of earlier sessions, too; the same for all
        pages."""
        self.points_mm: dict[str, FloatArray] = {}
        """AC, PC or midline point as far as they are set, until the plan holds all three; the same for all pages."""
        self.images: dict[str, PlacedImage] = {}
        """Other images that were registered, by the SHA-256 of their voxels; the same for all pages."""
        self._look(storage.read_look(case.volume.voxel_sha256) or self._first_look())
        self._kept = self._now
        case.followers.append(self._follow)

    def beside(self) -> Looking:
        """Return a look of another page: where this one is, and from then on its own."""
        other = copy.copy(self)
        other.marker, other.begun_mm, other.measured_mm = None, None, []
        other.select_known()
        self.case.followers.append(other._follow)
        return other

    def leave(self) -> None:
        """Follow the plan no longer: the page is closed."""
        with contextlib.suppress(ValueError):
            self.case.followers.remove(self._follow)

    def jump(self, place_mm: Sequence[float] | FloatArray) -> None:
        """Put the crosshair at a place (3,) in LPS, kept within the scan."""
        place = as_point(list(place_mm), "the crosshair")
        low, high = self.bounds_mm
        self.crosshair_mm = np.clip(place, low, high)

    def show(self, place_mm: Sequence[float] | FloatArray) -> None:
        """Put the crosshair at a place (3,), and bring it into view where the cuts show another part."""
        self.jump(place_mm)
        if np.abs(self.crosshair_mm - self.center_mm).max() > SEEN_SHARE * self.field_mm:
            self.center_mm = self.crosshair_mm.copy()

    def scroll(self, view: str, steps: float) -> None:
        """Move the crosshair through a standard view by slices of the scan."""
        _require_view(view, tuple(STANDARD))
        cut = self.cut(view)
        self.jump(self.crosshair_mm + steps * self.step_mm * cut.away)

    def nudge(self, view: str, across_mm: float, down_mm: float) -> None:
        """Move the crosshair within a standard view, and bring it into view."""
        _require_view(view, tuple(STANDARD))
        cut = self.cut(view)
        self.show(self.crosshair_mm + across_mm * cut.right + down_mm * cut.down)

    def along(self, way_mm: float) -> None:
        """Move the crosshair along the selected trajectory, between its ends; nothing without one."""
        path = self.chosen
        if path is not None:
            depth = (self.crosshair_mm - path.entry_mm) @ path.inward + way_mm
            self.show(path.at_depth(np.clip(depth, 0.0, path.length_mm)))

    def zoom(self, view: str, factor: float, place_mm: FloatArray) -> None:
        """Enlarge (factor above 1) about ``place_mm`` (3,), which stays where it is on the screen."""
        _require_view(view, tuple(STANDARD))
        field = float(np.clip(self.field_mm / factor, LEAST_FIELD_MM, GREATEST_FIELD_MM))
        cut = self.cut(view)
        across, down, _ = cut.on_screen_mm(place_mm)
        share = 1.0 - field / self.field_mm
        self.center_mm = self.center_mm + share * (across * cut.right + down * cut.down)
        self.field_mm = field

    def fit(self) -> None:
        """Show the whole scan."""
        low, high = self.bounds_mm
        self.center_mm, self.field_mm = (low + high) / 2, float((high - low).max())

    def choose_window(self, name: str) -> None:
        """Choose a window preset."""
        if name not in WINDOWS_HU:
            raise UsageError(f"there is no window {name}; there are {', '.join(WINDOWS_HU)}")
        self.window, self.window_hu = name, WINDOWS_HU[name]

    def set_window(self, low_hu: float, high_hu: float) -> None:
        """Show ``low_hu`` black and ``high_hu`` white; raises `UsageError` unless the first is lower."""
        if not LOWEST_HU <= low_hu <= high_hu - NARROWEST_HU <= GREATEST_HU:
            raise UsageError(
                f"a window from {low_hu:g} to {high_hu:g} HU cannot be shown; it lies between {LOWEST_HU:g} and "
                f"{GREATEST_HU:g} HU and is {NARROWEST_HU:g} HU wide or wider"
            )
        self.window_hu = (low_hu, high_hu)
        self.window = next((name for name, known in WINDOWS_HU.items() if known == self.window_hu), OWN_WINDOW)

    def choose_layout(self, name: str) -> None:
        """Choose which views are shown how large."""
        if name not in LAYOUTS:
            raise UsageError(f"there is no layout {name}; there are {', '.join(LAYOUTS)}")
        self.layout = name

    def cut(self, view: str) -> Cut:
        """Return the plane that a view shows; a path view needs a selected trajectory."""
        _require_view(view, (*STANDARD, *PATH_VIEWS))
        if view in PATH_VIEWS:
            return self._path_cut(view)
        right, down = STANDARD[view]
        away = np.cross(right, down)
        center = self.center_mm + (self.crosshair_mm - self.center_mm) @ away * away
        return Cut(right, down, center, self.field_mm)

    @property
    def step_mm(self) -> float:
        """One step of scrolling: the usual gap between slices."""
        return self.case.volume.grid.typical_gap_mm

    def select(self, name: str | None) -> None:
        """Select a trajectory, or none."""
        self.selected = None if name is None else self.case.plan.trajectory(name).name

    @property
    def chosen(self) -> Trajectory | None:
        """The selected trajectory."""
        return next((one for one in self.case.plan.trajectories if one.name == self.selected), None)

    def show_region(self, name: str, colour: str, opacity: float) -> None:
        """Show a region in another colour and opacity, and keep that; if it cannot be written, nothing is changed."""
        regions, before = changed(self.regions, name, colour, opacity), dict(self.chosen_regions)
        self.chosen_regions[name] = ShownRegion(colour=colour, opacity=opacity)
        try:
            self.save()
        except RonnaplanError:
            self.chosen_regions.clear()
            self.chosen_regions.update(before)
            raise
        self.regions = regions

    def set_points(self, points_mm: dict[str, FloatArray]) -> None:
        """Keep the points (3,) of the AC-PC frame that are set so far; if they cannot be written, none is new."""
        before = dict(self.points_mm)
        self._set_points(points_mm)
        try:
            self.save()
        except RonnaplanError:
            self._set_points(before)
            raise

    def _set_points(self, points_mm: dict[str, FloatArray]) -> None:
        self.points_mm.clear()
        self.points_mm.update(points_mm)

    def save(self) -> None:
        """Write where one is looking, to find it again."""
        self._write(self._now)

    def keep(self) -> None:
        """The same where it has changed since; raises `UnwrittenError` where it cannot be written."""
        if (look := self._now) != self._kept:
            self._write(look)

    def _write(self, look: Look) -> None:
        self.storage.write_look(look)
        self._kept = look

    @property
    def _now(self) -> Look:
        return Look(
            voxel_sha256=self.case.volume.voxel_sha256,
            crosshair=tuple(self.crosshair_mm),
            center=tuple(self.center_mm),
            field_mm=self.field_mm,
            window=self.window,
            window_hu=self.window_hu,
            layout=self.layout,
            shown_as=self.preset or self.surface,
            selected=self.selected,
            points={name: tuple(place) for name, place in self.points_mm.items()},
            images=dict(self.images),
            regions=dict(self.chosen_regions),
        )

    def _follow(self, before: Plan, after: Plan) -> None:
        """Keep what is selected at its place in the list, also where its name has changed."""
        names = [one.name for one in before.trajectories]
        place = names.index(self.selected) if self.selected in names else len(names)
        if self.chosen is None:
            paths = after.trajectories
            self.selected = paths[min(place, len(paths) - 1)].name if paths else None

    def _first_look(self) -> Look:
        low, high = self.bounds_mm
        middle = tuple((low + high) / 2)
        field = float((high - low).max())
        return Look(voxel_sha256="", crosshair=middle, center=middle, field_mm=field, window="bone")

    def _look(self, look: Look) -> None:
        self.crosshair_mm = np.array(look.crosshair)
        self.center_mm = np.array(look.center)
        self.field_mm = look.field_mm
        self.window = look.window if look.window in WINDOWS_HU else "bone"
        self.window_hu = WINDOWS_HU[self.window]
        if look.window_hu is not None:
            with contextlib.suppress(UsageError):  # by whom it was written is not known
                self.set_window(*look.window_hu)
        self.layout = look.layout if look.layout in LAYOUTS else LAYOUTS[0]
        self._set_points({name: np.array(place) for name, place in look.points.items()})
        self.images.update(look.images)
        self.chosen_regions.update(look.regions)
        with contextlib.suppress(UsageError):
            self.show_as(look.shown_as)
        self.selected = look.selected
        self.select_known()

    def select_known(self) -> None:
        """Select the first trajectory where the one that was selected is gone."""
        if self.chosen is None and self.case.plan.trajectories:
            self.selected = self.case.plan.trajectories[0].name

    def _path_cut(self, view: str) -> Cut:
        if self.chosen is None:
            raise UsageError("no trajectory is selected; select one")
        # While an end is dragged the view stays where it was, or it would slip from under the pointer.
        plan = self.case.plan if self.case.before_drag is None else self.case.before_drag
        path = plan.trajectory(self.chosen.name)
        right, down = path_axes(view, path)
        field = max(PATH_FIELD_MM, path.length_mm + 30.0)
        if view != ACROSS:
            return Cut(right, down, path.at_depth(np.array(path.length_mm / 2)), field)
        depth = np.clip((self.crosshair_mm - path.entry_mm) @ path.inward, 0.0, path.length_mm)
        return Cut(right, down, path.at_depth(depth), field / 2)


def _require_view(view: str, known: Sequence[str]) -> None:
    if view not in known:
        raise UsageError(f"there is no view {view} here; there are {', '.join(known)}")
