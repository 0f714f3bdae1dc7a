"""What is drawn again when something changes, and what is not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from ronnaplan.planner import painter as painting
from ronnaplan.planner.cuts import sampled
from ronnaplan.planner.head_view import HeadView
from ronnaplan.planner.painter import Painter
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.state import PlannerState
from tests.loops import run


class Values(dict[str, Any]):
    """Stands for the values that a page shows."""

    def __getattr__(self, name: str) -> Any:
        return self[name]

    def __setattr__(self, name: str, value: Any) -> None:
        self[name] = value


def test_a_window_that_is_dragged_samples_no_cut_again(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = []

    def counting(*of: Any) -> Any:
        counted.append(of)
        return sampled(*of)

    monkeypatch.setattr(painting, "sampled", counting)
    monkeypatch.setattr(Painter, "_rest_soon", lambda self: None)

    async def drag() -> None:
        server = SimpleNamespace(state=Values(show_rejected=False))
        painter = Painter(state, server, Pointer(state), HeadView(state))
        painter.move()
        painter.refresh_views()
        first, before = len(counted), server.state["picture_axial"]
        state.look.set_window(-200.0, 300.0)
        painter.refresh_views()
        assert server.state["picture_axial"] != before
        assert len(counted) == first
        state.look.scroll("axial", 1)
        painter.refresh_views()
        assert len(counted) > first

    run(drag())
