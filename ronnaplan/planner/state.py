"""All that the planner knows and can do, without a browser: the views draw this object and call its parts."""

from __future__ import annotations

import copy
from functools import partial

import numpy as np

from ronnaplan.case import marker_edits
from ronnaplan.case.edits import OpenCase
from ronnaplan.case.surroundings import Labels, Rules
from ronnaplan.ct import CTVolume
from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray, as_point
from ronnaplan.planner.aligning import Alignment
from ronnaplan.planner.following import Following
from ronnaplan.planner.looking import Looking
from ronnaplan.planner.offers import Offers
from ronnaplan.planner.regions import Outlines, first_shown, joined
from ronnaplan.planner.registering import Registering
from ronnaplan.planner.second import Second, known_by
from ronnaplan.planner.storage import LANDMARKS, PlacedImage, Storage
from ronnaplan.planner.worker import Job, Start
from ronnaplan.planning import Landmarks, Ruler, Trajectory


class PlannerState:
    """One open case with what a person sees of it.

    The parts: ``case`` (documents and their changes), ``look`` (crosshair, cuts, what is selected), ``registering``
    (readings and pointing), ``offers`` (proposals). Here stands only what takes two of them.
    """

    def __init__(
        self,
        volume: CTVolume,
        storage: Storage,
        rules: Rules | None = None,
        no_go: Labels | None = None,
        labels: Labels | None = None,
    ) -> None:
        """Open a case; ``no_go`` are masks (K, J, I) of the scan to keep away from, ``labels`` are shown only.

        Raises `FrameMismatchError` where a document is of another scan.
        """
        self.storage = storage
        self.start: Start = Job.do
        """Does what takes long; the planner's page has it done in another process."""
        self.case = OpenCase(volume, storage.documents, rules, no_go)
        self.look = Looking(self.case, storage)
        self.second: Second | None = None
        """Another image of the same head, shown over the cuts."""
        self.masks = joined(self.case.no_go, labels or {})
        """All regions that are shown, by name."""
        self.look.regions = first_shown(self.case.no_go, self.masks, self.look.chosen_regions)
        self.outlines = Outlines(volume, self.masks)
        self.registering = Registering(self.case, storage, lambda job: self.start(job))
        self.following = Following(self.case, storage)
        self.offers = Offers(self.case, self.look, lambda job: self.start(job))

    def beside(self) -> PlannerState:
        """Return the same case for another page, which looks where it likes and selects for itself."""
        other = copy.copy(self)
        other.look = self.look.beside()
        other.outlines = Outlines(self.case.volume, self.masks)
        other.offers = Offers(self.case, other.look, self.offers.start, self.offers.offered)
        return other

    def take_second(self, image: CTVolume, name: str) -> None:
        """Show another image of the same head over the cuts, once it is known where it lies."""
        key = known_by(image)
        known = self.look.images.get(key)

        def keep(found: Alignment) -> None:
            rows = [tuple(row) for row in found.moving_from_fixed.tolist()]
            self.look.images[key] = PlacedImage.model_validate(
                {"image_from_scan": tuple(rows), "apart_mm": found.apart_mm, "exchanged": found.exchanged}
            )
            self.look.save()

        self.second = Second(self.case.volume, image, name, lambda job: self.start(job), keep)
        if known is not None and not self.second.placed:
            self.second.place(Alignment(np.array(known.image_from_scan), known.apart_mm, known.exchanged))

    @property
    def other(self) -> Second:
        """The second image; raises `UsageError` where there is none."""
        if self.second is None:
            raise UsageError("there is no second image; name one with --second")
        return self.second

    def add_trajectory(self, entry_mm: FloatArray, target_mm: FloatArray, name: str | None = None) -> str:
        """Add a trajectory from entry (3,) to target (3,), LPS mm, and show it; returns its name."""
        plan = self.case.plan
        taken = {one.name for one in plan.trajectories}
        added = Trajectory(name or _free("T", taken), entry_mm, target_mm, plan.frame)
        self.case.add(added)
        self.show_path(added.name)
        return added.name

    def add_ruler(self, letter: str, points_mm: list[FloatArray]) -> None:
        """Keep a distance (two points) or an angle (three), named by a letter and a number that is free."""
        plan = self.case.plan
        taken = {one.name for one in plan.rulers}
        self.case.change_plan(plan.add_ruler(Ruler(_free(letter, taken), np.array(points_mm))))

    def remove_ruler(self, name: str) -> None:
        """Remove a distance or an angle."""
        self.case.change_plan(self.case.plan.remove_ruler(name))

    def show_ruler(self, name: str) -> None:
        """Put the crosshair at the second point of a distance or an angle."""
        self.look.show(self.case.plan.ruler(name).points_mm[1])

    def localize(self, diameter_mm: float) -> None:
        """Look for markers of a diameter, made as those there are, which then take their place."""
        layer_mm = self.case.fiducials.marker.layer_mm if self.case.fiducials else 0.0
        work = partial(marker_edits.localized, self.case.volume, diameter_mm, layer_mm)
        self.start(Job(f"looking for balls of {diameter_mm:g} mm", work, self.case.replace_markers, tells=True))

    def show_path(self, name: str) -> None:
        """Select a trajectory and put the crosshair at its target."""
        self.look.select(name)
        self.look.show(self.case.plan.trajectory(name).target_mm)

    def pick_marker(self, label: str) -> None:
        """Select a marker; while the pairing is ambiguous this points at it."""
        self.look.marker = marker_edits.named(self.case.found, label).label
        self.registering.pick_marker(label)

    def jump_to_marker(self, label: str) -> None:
        """Select a marker and put the crosshair at its center."""
        self.look.show(marker_edits.named(self.case.found, label).center)
        self.pick_marker(label)

    def jump_to_rejected(self, index: int) -> None:
        """Put the crosshair at a rejected candidate."""
        self.look.show(marker_edits.candidate(self.case.found, index).center)

    @property
    def landmarks_mm(self) -> dict[str, FloatArray]:
        """The points (3,) of the AC-PC frame that are set, by name."""
        known = self.case.plan.landmarks
        if known is None:
            return self.look.points_mm
        return dict(zip(LANDMARKS, (known.ac_mm, known.pc_mm, known.midline_mm), strict=True))

    def set_landmark(self, which: str, place_mm: FloatArray) -> None:
        """Set AC, PC or the midline point (3,); with the third the plan has its frame.

        Raises `InputError` where the three points lie on one line, and changes nothing then.
        """
        if which not in LANDMARKS:
            raise UsageError(f"there is no point {which}; there are {', '.join(LANDMARKS)}")
        place = as_point(list(place_mm), which)
        points = {**self.landmarks_mm, which: place}
        if len(points) == len(LANDMARKS):
            self.case.set_landmarks(Landmarks(*(points[name] for name in LANDMARKS)))
        else:
            self.look.set_points(points)

    def jump_to_landmark(self, which: str) -> None:
        """Put the crosshair at AC, PC or the midline point."""
        if which not in self.landmarks_mm:
            raise UsageError(f"{which} is not set; put the crosshair there and set it")
        self.look.show(self.landmarks_mm[which])


def _free(letter: str, taken: set[str]) -> str:
    """Return the first name of ``letter`` and a number that is not ``taken``."""
    return next(f"{letter}{n}" for n in range(1, len(taken) + 2) if f"{letter}{n}" not in taken)
