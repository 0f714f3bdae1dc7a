"""What the planner will need, loaded beside the reading of the scan: whoever asks for it finds it, or waits for it."""

from __future__ import annotations

import contextlib
import threading


def load_libraries() -> None:
    """Begin to load the libraries of the web server, and the planner itself."""
    threading.Thread(target=_load, daemon=True).start()


def _load() -> None:
    with contextlib.suppress(ModuleNotFoundError):  # told by `ronnaplan.planner.server.serve`
        import aiohttp.web  # noqa: F401
        import trame.ui.html  # noqa: F401
        import wslink.backends.aiohttp  # noqa: F401

        import ronnaplan.planner.app
        import ronnaplan.planner.handing
        import ronnaplan.planner.head_routes
        import ronnaplan.planner.starting  # noqa: F401
