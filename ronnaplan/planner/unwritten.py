"""What could not be written, as on a full disk: said plainly on every page, and written as soon as it can be."""

from __future__ import annotations

from collections.abc import Collection

from ronnaplan.case.edits import OpenCase
from ronnaplan.errors import RonnaplanError, UnwrittenError
from ronnaplan.planner.tab import Tab

WRITTEN = "the change that could not be written is written now"


def write_again(case: OpenCase, tabs: Collection[Tab]) -> bool:
    """Try to write what could not be, and show on each page what waits; return whether it has to be drawn anew.

    Nothing is written while an end is dragged, which goes on from the plan as it was.
    """
    if case.dragging:
        return False
    why: RonnaplanError | None = None
    drawn = False
    try:
        drawn = case.unwritten.make()
        if drawn:
            for tab in tabs:
                tab.shown.update({"message": "", "news": WRITTEN})
    except UnwrittenError as error:
        why = error
    except RonnaplanError as error:  # another hand changed the same thing, say
        drawn = True
        for tab in tabs:
            tab.refuse(error)
    for tab in tabs:
        tab.shown["unsaved"] = _unsaved(tab, why)
        tab.shown.flush()
    return drawn


def _unsaved(tab: Tab, why: RonnaplanError | None) -> dict[str, object]:
    """Return what is not kept yet and why; empty where all is."""
    if tab.unkept is not None:
        tab.keep()
    waits = [*(["the last change"] if why else []), *(["where you look"] if tab.unkept else [])]
    told = {"what": " and ".join(waits), "why": str(why or tab.unkept), "change": why is not None}
    return told if waits else {}
