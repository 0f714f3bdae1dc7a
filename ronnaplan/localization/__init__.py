"""Every marker of a scan, its centre and how sure it is."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ronnaplan.localization.fiducials import Fiducial, FiducialFlag, Fiducials, Rejected
from ronnaplan.localization.template import Template

if TYPE_CHECKING:
    from ronnaplan.localization.localizer import check_request, localize
    from ronnaplan.localization.size import common_diameter

_HOMES = {"check_request": "localizer", "common_diameter": "size", "localize": "localizer"}
"""Where each name lives that needs compiled code; it is loaded when first asked for."""

__all__ = [
    "Fiducial",
    "FiducialFlag",
    "Fiducials",
    "Rejected",
    "Template",
    "check_request",
    "common_diameter",
    "localize",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
