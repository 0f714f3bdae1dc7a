"""From the tracker to the robot: coordinate chain, tool calibration, trajectories, stereo re-localization."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
