"""Planning: trajectories that can be judged in the scan, and markers placed where they help.

`Head.of` prepares a scan; `measure` tells everything about one trajectory, `judge` holds it against `Limits`,
`propose` finds entries for a target, `place_markers` finds places for the markers.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ronnaplan.planning.trajectory import INSTRUMENTS, Instrument, Trajectory

if TYPE_CHECKING:
    from ronnaplan.planning.head import Head
    from ronnaplan.planning.labels import read_label_map
    from ronnaplan.planning.limits import Limits, Verdict, judge
    from ronnaplan.planning.measures import Measures, measure
    from ronnaplan.planning.placement import Placement, place_markers
    from ronnaplan.planning.plan import Landmarks, Plan
    from ronnaplan.planning.proposals import Proposals, propose

_HOMES = {
    "Head": "head",
    "Landmarks": "plan",
    "Limits": "limits",
    "Measures": "measures",
    "Placement": "placement",
    "Plan": "plan",
    "Proposals": "proposals",
    "Verdict": "limits",
    "judge": "limits",
    "measure": "measures",
    "place_markers": "placement",
    "propose": "proposals",
    "read_label_map": "labels",
}
"""Where each name lives; what loads compiled code is loaded when first asked for."""

__all__ = [
    "INSTRUMENTS",
    "Head",
    "Instrument",
    "Landmarks",
    "Limits",
    "Measures",
    "Placement",
    "Plan",
    "Proposals",
    "Trajectory",
    "Verdict",
    "judge",
    "measure",
    "place_markers",
    "propose",
    "read_label_map",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
