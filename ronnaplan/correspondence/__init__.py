"""Correspondence: which CT point is which tracker point, or an honest refusal.

`match_points` is exact and weighs every answer against its rivals; `match_by_similarity` is the published
algorithm; `describe_layout` says from the CT alone how distinguishable a marker layout is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ronnaplan.correspondence.pairing import Pairing, Rival

if TYPE_CHECKING:
    from ronnaplan.correspondence.layout import Layout, describe_layout, rival_distance
    from ronnaplan.correspondence.matching import match_points
    from ronnaplan.correspondence.similarity import match_by_similarity

__all__ = [
    "Layout",
    "Pairing",
    "Rival",
    "describe_layout",
    "match_by_similarity",
    "match_points",
    "rival_distance",
]

_HOMES = {
    "Layout": "layout",
    "describe_layout": "layout",
    "match_by_similarity": "similarity",
    "match_points": "matching",
    "rival_distance": "layout",
}


def __getattr__(name: str) -> Any:
    """Load numba only when a matcher is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
