"""ronnaplan: from a head CT with spherical markers to coordinates a robot can trust.

Research software, not a medical device.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ronnaplan.ct import CTVolume, read_ct
    from ronnaplan.localization import Fiducials, localize

__version__ = "0.1.0"

_ROOMS = {
    "CTVolume": "ronnaplan.ct",
    "read_ct": "ronnaplan.ct",
    "Fiducials": "ronnaplan.localization",
    "localize": "ronnaplan.localization",
}
"""Where each public name lives; a room is entered only when one of its names is used."""

__all__ = ["CTVolume", "Fiducials", "__version__", "localize", "read_ct"]


def __getattr__(name: str) -> Any:
    if name not in _ROOMS:
        raise AttributeError(f"module 'ronnaplan' has no attribute '{name}'")
    return getattr(import_module(_ROOMS[name]), name)
