"""The files that carry results from one stage to the next, and the exporters to other tools' formats."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
