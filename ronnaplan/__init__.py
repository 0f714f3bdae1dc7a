"""ronnaplan: from a head CT with spherical markers to coordinates a robot can trust.

The way from a scan to the tracker: `read_ct` and `localize` give its markers; `read_recording` and `find_markers` those
that the tracker saw; `register_markers` pairs both and registers (by `match_points` and `register_points`), or refuses;
`write_fiducials` and `write_registration` keep what came of it.

Research software, not a medical device. What it does in the course of it is told to the logger "ronnaplan", which is
silent until asked: ``logging.basicConfig(level="INFO")`` shows each step, ``"DEBUG"`` candidates and residuals, too.
No line names a patient or a path.
"""

import logging

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.2.0"

logging.getLogger(__name__).addHandler(logging.NullHandler())
