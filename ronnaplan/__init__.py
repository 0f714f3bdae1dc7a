"""ronnaplan: from a head CT with spherical markers to coordinates a robot can trust.

Research software, not a medical device.
"""

__version__ = "0.1.0"
