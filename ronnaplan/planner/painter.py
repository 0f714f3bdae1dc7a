"""What the page shows, drawn again where it changed: pictures, what lies over them, and the panels."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.case.judgement import Judgement
from ronnaplan.errors import UsageError
from ronnaplan.planner import panels
from ronnaplan.planner.arguments import Pixels
from ronnaplan.planner.cuts import HEAD, PATH_VIEWS, STANDARD, Picture, jpeg, picture_of, png, sampled, shaded
from ronnaplan.planner.head_view import HeadView
from ronnaplan.planner.measuring import ruler_rows
from ronnaplan.planner.opening import seen_from
from ronnaplan.planner.over_cut import over_cut
from ronnaplan.planner.over_head import over_head
from ronnaplan.planner.panes import GREATEST_RATIO, MOST_MOVING_PIXELS, MOST_STILL_PIXELS, Pane
from ronnaplan.planner.pixels import Pixel
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.regions import region_rows
from ronnaplan.planner.shown import Shown
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Plan
from ronnaplan.scene.cut import Cut

CUTS = (*STANDARD, *PATH_VIEWS)

REST_S = 0.2
"""When nothing has moved for so long, pictures are drawn with all pixels and without loss."""


@dataclass(frozen=True)
class _Drawn:
    """A picture that the page has: ``of`` what, and whether it is as it is ``still``."""

    of: tuple[Any, ...]
    still: bool
    picture: Picture


class Painter:
    """Draws one `PlannerState` into what one page shows."""

    def __init__(
        self, state: PlannerState, shown: Shown, pointer: Pointer, head: HeadView, measured: Callable[[], bool]
    ) -> None:
        """Draw nothing yet; ``measured`` tells whether to measure a trajectory takes no long time by now."""
        self.state, self.shown, self.pointer, self.head, self.measured = state, shown, pointer, head, measured
        self.panes = dict.fromkeys((*CUTS, HEAD), Pane())
        self.moving = False
        self.pictures = False
        """Whether the page cannot draw in 3-D, and is sent pictures."""
        self._drawn: dict[str, _Drawn] = {}
        self._values: dict[str, tuple[tuple[Any, ...], NDArray[np.float32]]] = {}
        self._resting: asyncio.TimerHandle | None = None
        self._pointed: tuple[str, Pixel | None] = (HEAD, None)
        """The view and the place in it that is pointed at, None for the crosshair, by keyboard."""

    def take_size(self, view: str, width: Pixels, height: Pixels, ratio: float, em: Pixels) -> None:
        """Take how large the page shows a view, and its letters; it is drawn so large when all are known."""
        if view not in self.panes or not 0 < ratio <= GREATEST_RATIO:
            raise UsageError(f"there is no view {view} with {ratio:g} pixels to one; reload the page")
        self.panes[view] = Pane(max(width, 1.0), max(height, 1.0), ratio, max(em, 1.0))
        self.rest_soon()

    def move(self) -> None:
        """Draw coarsely from now on, until nothing has moved for a while."""
        self.moving = True
        self.rest_soon()

    def rest_soon(self) -> None:
        """Draw all of it, with all pixels, once nothing has moved for a while."""
        self.close()
        self._resting = asyncio.get_running_loop().call_later(REST_S, self._rest)

    def close(self) -> None:
        """Draw nothing more by itself."""
        if self._resting is not None:
            self._resting.cancel()

    def _rest(self) -> None:
        self.moving, self._resting = False, None
        self._values.clear()
        self.refresh()
        self.shown.flush()

    def refresh(self) -> None:
        """Draw whatever is not as the page has it; pictures only where their plane or window changed."""
        self.refresh_views()
        state = self.state
        self.refresh_measures(state.case.plan)
        self.shown.update(
            {
                "markers": panels.marker_rows(state),
                "rejected": panels.rejected_rows(state),
                "paths": panels.path_rows(state),
                "second": state.second.told(state.look.blend) if state.second else {"name": ""},
                "regions": region_rows(state.look.regions),
                "rulers": ruler_rows(state),
                "landmarks": panels.landmark_rows(state),
                "robot": panels.robot_doubts(state),
                "registration": panels.registration_panel(state),
                "pointing": panels.pointing_panel(state),
                "followed": panels.following_panel(state),
                "proposals": panels.proposal_rows(state),
                "placement": panels.placement_line(state),
                "readings": state.storage.readings(),
                "documents": list(state.storage.found),
            }
        )

    def refresh_measures(self, plan: Plan) -> None:
        """Tell the measures of a ``plan``, and draw it in 3-D: while an end is dragged, that of just before."""
        state, judged = self.state, Judgement(problem=panels.MEASURING)
        chosen = next((one for one in plan.trajectories if one.name == state.look.selected), None)
        if chosen is not None and (self.measured() or state.case.surroundings.knows(chosen, plan)):
            judged = state.case.judge(chosen)
        self.shown["chosen"] = panels.chosen_path(state, judged)
        self.head.update(plan)
        self.shown["volume"] = {} if self.pictures else self.head.drawn_whole
        self.shown["things"] = self.head.scene.listed if self.head.scene else []
        self.shown["picture_head"] = self.head.picture(self._shape(HEAD)) if self.pictures else None

    def refresh_views(self) -> None:
        """Draw the cuts, what lies over the 3-D picture, and how one looks."""
        for view in CUTS:
            self.shown[f"drawn_{view}"] = over_cut(self.state, view, self._rejected_too, self.panes[view])
            self.shown[f"picture_{view}"] = self._picture(view)
        self.refresh_head()
        self.shown["look"] = self._look()
        self._tell_pointed()

    def point(self, view: str, at: Pixel | None) -> None:
        """Tell from now on what lies at a place in a view; at the crosshair, and aloud, where ``at`` is None."""
        self._pointed = (view, at)
        self._tell_pointed()

    def _tell_pointed(self) -> None:
        """Tell the HU where one points, and where that is: cuts go on beneath a pointer that rests."""
        (view, at), look, told = self._pointed, self.state.look, ""
        if view in CUTS and (view in STANDARD or look.chosen is not None):
            place = look.crosshair_mm if at is None else at.place_mm(look.cut(view))
            told = panels.place_line(self.state, place)
        self.shown.update({"under": told, "spoken": told if at is None else ""})

    def refresh_head(self) -> None:
        """Draw what lies over the 3-D view, and tell from where it is seen."""
        self.shown["eye"] = seen_from(
            self.state, self.head.camera, self.panes, self.head.scene.reach_mm if self.head.scene else 0.0
        )
        self.shown["drawn_head"] = over_head(
            self.state,
            self.head.camera,
            self._rejected_too,
            self.head.region_places_mm,
            self.panes[HEAD],
            self.head.parts.wanting,
            drawn_here=not self.pictures,
        )

    @property
    def _rejected_too(self) -> bool:
        return self.shown["show_rejected"] is True

    def _look(self) -> dict[str, Any]:
        """Return how one looks, in the page's words."""
        look, case = self.state.look, self.state.case
        return {
            "window": look.window,
            "level": round(sum(look.window_hu) / 2, 1),
            "width": round(look.window_hu[1] - look.window_hu[0], 1),
            "adding": self._asks(),
            "measuring": self.pointer.measuring.wanted,
            "asks": self.pointer.measuring.asks,
            "can_undo": case.can_undo or self.pointer.begun,
            "can_redo": case.can_redo,
            "surface": look.surface,
            "layout": look.layout,
            "opened": look.opened,
            "shown_as": look.preset or look.surface,
            "strength": look.strength,
            "marker": look.marker or "",
            "sought": case.fiducials.marker.diameter_mm if case.fiducials else 0,
        }

    def _asks(self) -> str:
        if not self.pointer.adding:
            return ""
        return "click the entry" if self.state.look.begun_mm is None else "click the target"

    def _picture(self, view: str) -> Picture | None:
        state = self.state
        if view in PATH_VIEWS and state.look.chosen is None:
            return None
        cut, window, pane = state.look.cut(view), state.look.window_hu, self.panes[view]
        of = (tuple(cut.center_mm.round(6)), tuple(cut.right), tuple(cut.down), cut.field_mm, window, pane)
        of += state.second.look(state.look.blend) if state.second else ()
        last = self._drawn.get(view)
        if last is None or last.of != of or not (last.still or self.moving):
            shades = shaded(self._sampled(view, cut), window)
            if state.second is not None:
                shades = state.second.over(shades, cut, state.look.blend)
            made = picture_of("jpeg", jpeg(shades)) if self.moving else picture_of("png", png(shades))
            last = self._drawn[view] = _Drawn(of, not self.moving, made)
        return last.picture

    def _sampled(self, view: str, cut: Cut) -> NDArray[np.float32]:
        """Return a cut's values; kept while something moves, for a window that is dragged changes none of them."""
        shape = self._shape(view)
        of = (*cut.center_mm.tolist(), *cut.right.tolist(), *cut.down.tolist(), cut.field_mm, shape)
        known = self._values.get(view)
        if known is None or known[0] != of:
            known = of, sampled(self.state.look.scan, cut, shape)
        if self.moving:
            self._values[view] = known
        return known[1]

    def _shape(self, view: str) -> tuple[int, int]:
        """Return rows and columns of a view's picture as it is drawn now."""
        if not self.moving:
            return self.panes[view].shape(MOST_STILL_PIXELS)
        # while an end is dragged all views are drawn, and the head takes longest
        held = view == HEAD and self.state.case.dragging
        return self.panes[view].shape(MOST_MOVING_PIXELS // 3 if held else MOST_MOVING_PIXELS)
