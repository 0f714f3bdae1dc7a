"""Planning: trajectories that can be judged in the scan, and markers placed where they help.

`Head.of` prepares a scan; `measure` tells everything about one trajectory, `judge` holds it against `Limits`,
`propose` finds entries for a target, `place_markers` finds places for the markers.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
