"""Rigid registration of paired points, its residuals, and the error to expect at targets."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
