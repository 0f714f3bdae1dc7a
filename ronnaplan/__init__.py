"""ronnaplan: from a head CT with spherical markers to coordinates a robot can trust.

Research software, not a medical device.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.1.0"
