"""ronnaplan: from a head CT with spherical markers to coordinates a robot can trust.

Research software, not a medical device.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ronnaplan.correspondence import Pairing, match_points
    from ronnaplan.ct import CTVolume, read_ct
    from ronnaplan.localization import Fiducials, localize
    from ronnaplan.planning import Trajectory
    from ronnaplan.registration import Registration, register_points

__version__ = "0.1.0"

_ROOMS = {
    "CTVolume": "ronnaplan.ct",
    "read_ct": "ronnaplan.ct",
    "Fiducials": "ronnaplan.localization",
    "localize": "ronnaplan.localization",
    "Pairing": "ronnaplan.correspondence",
    "match_points": "ronnaplan.correspondence",
    "Registration": "ronnaplan.registration",
    "register_points": "ronnaplan.registration",
    "Trajectory": "ronnaplan.planning",
}
"""Where each public name lives; a room is entered only when one of its names is used."""

__all__ = [
    "CTVolume",
    "Fiducials",
    "Pairing",
    "Registration",
    "Trajectory",
    "__version__",
    "localize",
    "match_points",
    "read_ct",
    "register_points",
]


def __getattr__(name: str) -> Any:
    if name not in _ROOMS:
        raise AttributeError(f"module 'ronnaplan' has no attribute '{name}'")
    return getattr(import_module(_ROOMS[name]), name)
