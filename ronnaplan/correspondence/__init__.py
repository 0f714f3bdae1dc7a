"""Correspondence: which CT point is which tracker point, or an honest refusal.

`match_points` is exact and weighs every answer against its rivals; `match_by_similarity` is the published
algorithm; `describe_layout` says from the CT alone how distinguishable a marker layout is.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
