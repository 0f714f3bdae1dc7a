"""What the page shows, drawn again where it changed: pictures, what lies over them, and the panels."""

from __future__ import annotations

import asyncio
import base64
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.case.surroundings import Judgement, Surroundings
from ronnaplan.errors import UsageError
from ronnaplan.planner import panels
from ronnaplan.planner.cuts import HEAD, PATH_VIEWS, STANDARD, jpeg, png, sampled, shaded
from ronnaplan.planner.head_view import HeadView
from ronnaplan.planner.measuring import ruler_rows
from ronnaplan.planner.opening import seen_from
from ronnaplan.planner.over_cut import over_cut
from ronnaplan.planner.over_head import over_head
from ronnaplan.planner.panes import GREATEST_RATIO, MOST_MOVING_PIXELS, MOST_STILL_PIXELS, Pane
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.state import PlannerState
from ronnaplan.scene.cut import Cut

CUTS = (*STANDARD, *PATH_VIEWS)

REST_S = 0.2
"""When nothing has moved for so long, pictures are drawn with all pixels and without loss."""


@dataclass(frozen=True)
class _Drawn:
    """A picture that the page has: ``of`` what, and whether it is as it is ``still``."""

    of: tuple[Any, ...]
    still: bool
    url: str


class Painter:
    """Draws one `PlannerState` into the values that the page of one trame server shows."""

    def __init__(self, state: PlannerState, server: Any, pointer: Pointer, head: HeadView) -> None:
        self.state, self.server, self.pointer, self.head = state, server, pointer, head
        self.panes = dict.fromkeys((*CUTS, HEAD), Pane())
        self.moving = False
        self.pictures = False
        """Whether a page cannot draw in 3-D, and is sent pictures."""
        self.measured_against: Surroundings | None = None
        """What all trajectories were measured against; what another takes to measure is not waited for here."""
        self._drawn: dict[str, _Drawn] = {}
        self._values: dict[str, tuple[tuple[Any, ...], NDArray[np.float32]]] = {}
        self._resting: asyncio.TimerHandle | None = None

    @property
    def measured(self) -> bool:
        """Whether to measure a trajectory takes no long time."""
        return self.measured_against is self.state.case.surroundings

    def take_size(self, view: str, width: float, height: float, ratio: float) -> None:
        """Take how large the page shows a view; it is drawn so large when all are known."""
        if view not in self.panes or not 0 < ratio <= GREATEST_RATIO:
            raise UsageError(f"there is no view {view} with {ratio:g} pixels to one; reload the page")
        self.panes[view] = Pane(max(width, 1.0), max(height, 1.0), ratio)
        self._rest_soon()

    def move(self) -> None:
        """Draw coarsely from now on, until nothing has moved for a while."""
        self.moving = True
        self._rest_soon()

    def _rest_soon(self) -> None:
        if self._resting is not None:
            self._resting.cancel()
        self._resting = asyncio.get_running_loop().call_later(REST_S, self._rest)

    def _rest(self) -> None:
        self.moving, self._resting = False, None
        self._values.clear()
        with self.server.state:
            self.refresh()

    def refresh(self) -> None:
        """Draw whatever is not as the page has it; pictures only where their plane or window changed."""
        self.refresh_views()
        values, state = self.server.state, self.state
        judged = Judgement(problem="measuring ...")
        if state.look.chosen and self.measured:
            judged = state.case.judge(state.look.chosen)
        values.markers, values.rejected = panels.marker_rows(state), panels.rejected_rows(state)
        values.paths, values.chosen = panels.path_rows(state), panels.chosen_path(state, judged)
        values.second = state.second.told if state.second else {"name": ""}
        values.rulers = ruler_rows(state)
        values.landmarks = panels.landmark_rows(state)
        values.registration, values.pointing = panels.registration_panel(state), panels.pointing_panel(state)
        values.proposals, values.placement = panels.proposal_rows(state), panels.placement_line(state)
        values.readings = state.storage.readings()
        values.look = {
            "window": state.look.window,
            "level": round(sum(state.look.window_hu) / 2, 1),
            "width": round(state.look.window_hu[1] - state.look.window_hu[0], 1),
            "adding": self._asks(),
            "measuring": self.pointer.measuring.wanted,
            "asks": self.pointer.measuring.asks,
            "can_undo": state.case.can_undo,
            "can_redo": state.case.can_redo,
            "surface": state.look.surface,
            "layout": state.look.layout,
            "opened": state.look.opened,
            "shown_as": state.look.preset or state.look.surface,
            "strength": state.look.strength,
            "marker": state.look.marker or "",
            "sought": state.case.fiducials.marker.diameter_mm if state.case.fiducials else 0,
        }
        if self.measured:
            self.head.update()
            values.volume = {} if self.pictures else self.head.drawn_whole
            values.things = self.head.scene.listed if self.head.scene else []
            values.picture_head = self.head.picture(self._shape(HEAD)) if self.pictures else ""

    def refresh_views(self) -> None:
        """Draw the cuts, and what lies over the 3-D picture."""
        values = self.server.state
        for view in CUTS:
            values[f"drawn_{view}"] = over_cut(self.state, view, values.show_rejected, self.panes[view])
            values[f"picture_{view}"] = self._picture(view)
        self.refresh_head()

    def refresh_head(self) -> None:
        """Draw what lies over the 3-D view, and tell from where it is seen."""
        values = self.server.state
        values.eye = seen_from(self.state, self.head.camera, self.panes)
        values.drawn_head = over_head(
            self.state,
            self.head.camera,
            values.show_rejected,
            self.head.region_places_mm,
            self.panes[HEAD],
            self.head.wanting,
        )

    def _asks(self) -> str:
        if not self.pointer.adding:
            return ""
        return "click the entry" if self.state.look.begun_mm is None else "click the target"

    def _picture(self, view: str) -> str:
        state = self.state
        if view in PATH_VIEWS and state.look.chosen is None:
            return ""
        cut, window, pane = state.look.cut(view), state.look.window_hu, self.panes[view]
        of = (tuple(cut.center_mm.round(6)), tuple(cut.right), tuple(cut.down), cut.field_mm, window, pane)
        of += state.second.look if state.second else ()
        last = self._drawn.get(view)
        if last is None or last.of != of or not (last.still or self.moving):
            shades = shaded(self._sampled(view, cut), window)
            if state.second is not None:
                shades = state.second.over(shades, cut)
            kind, drawn = ("jpeg", jpeg(shades)) if self.moving else ("png", png(shades))
            url = f"data:image/{kind};base64,{base64.b64encode(drawn).decode()}"
            last = self._drawn[view] = _Drawn(of, not self.moving, url)
        return last.url

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
