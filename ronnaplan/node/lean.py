"""pydicom for processes that decode no pixels: without the decoders that it loads wherever they are installed."""

from __future__ import annotations

import sys
from typing import Final

HEAVY: Final = ("PIL", "gdcm", "jpeg_ls", "libjpeg", "numpy", "openjpeg", "pylibjpeg", "requests", "tqdm")
"""What pydicom loads for pixels, and to fetch example files: 27 MB in each process, which most never use."""


def load_pydicom() -> None:
    """Load pydicom, unless it is, and keep it from what is `HEAVY`, which can be loaded afterwards all the same.

    Compressed pixels cannot be decoded in this process from now on, and none at all if numpy was not there before.
    """
    if "pydicom" in sys.modules:
        return
    hidden = [name for name in HEAVY if name not in sys.modules]
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type]  # None: "is not there" (import system, 5.3.1)
    try:
        import pydicom.dataset
        import pydicom.pixels  # noqa: F401
    finally:
        for name in hidden:
            del sys.modules[name]
