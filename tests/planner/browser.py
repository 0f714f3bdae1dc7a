"""A planner in a process of its own and a headless Chromium to use it with; both end with the test."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ronnaplan.documents.plan import read_plan
from ronnaplan.report.pdf import find_browser
from tests import cases

BROWSER = find_browser()

ADDRESS_BAR = ("WebUIOmniboxPopup", "WebUIOmniboxAimPopup")
"""What an address bar unfolds is a page of its own, which each new window would make: as dear as the planner's."""

UNUSED = (
    *("AvoidUnnecessaryBeforeUnloadCheckSync", "DestroyProfileOnBrowserClose", "HttpsUpgrades", "LensOverlay"),
    *("HttpsFirstBalancedModeAutoEnable", "MediaRouter", "PaintHolding", "ThirdPartyStoragePartitioning"),
    *("AvoidCorsURLLoaderRestartOnRedirect", "OptimizationHints", "NetworkTimeServiceQuerying", "AimEnabled"),
    "PreconnectToSearch",
)
"""What Playwright switches off, whose list is not read where another one is given."""

FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    f"--disable-features={','.join((*ADDRESS_BAR, *UNUSED))}",
)
"""Without these Chromium itself would look for hosts of its maker."""


PATIENCE_MS = 120_000
"""How long a page is waited for: far longer than it takes, even where much else runs beside."""

POLLING_MS = 100
"""How often a page is asked for what takes seconds to make: asked at each of its frames, as Playwright would, it draws
all of them meanwhile."""


def skip_reason() -> str | None:
    """Why no browser test can run here, None if they can."""
    if BROWSER is None:
        return "no Chromium is installed; the planner was not looked at in a browser"
    if importlib.util.find_spec("playwright") is None:
        return "the package playwright is not installed; the planner was not looked at in a browser"
    from playwright._impl._driver import compute_driver_executable

    command = [compute_driver_executable()[0], "--version"]  # playwright's own takes a hundred times as long
    try:
        subprocess.run(command, capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        return f"playwright's driver does not start here ({error}); no browser was looked at"
    return None


_REASON = skip_reason()
needs_browser = pytest.mark.skipif(_REASON is not None, reason=_REASON or "")


class Planner:
    """A running ``ronnaplan view``: its folder, its address, and how to kill it.

    Without ``surfaces`` its head has neither skin nor skull, to make which takes most of its processor's time.
    """

    def __init__(self, folder: Path, *options: str, surfaces: bool = False) -> None:
        self.folder = folder
        command = [sys.executable, "-m", "ronnaplan", "view", str(cases.CT), "--plan", str(folder / "plan.json")]
        self.process = subprocess.Popen(
            [*command, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder,
            env=environment(surfaces=surfaces),
        )  # fmt: skip
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/index\.html\?token=[\w-]{32}", self.url), self.url

    def kill(self) -> None:
        """End it at once, as a crash would."""
        self.process.kill()
        self.process.communicate()


def environment(*, surfaces: bool = True) -> dict[str, str]:
    """This process's environment with the project on its path; without ``surfaces`` as where VTK ends its process."""
    paths = [str(Path(__file__).resolve().parents[2])] + ([] if surfaces else [_without_pyvista().name])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


@cache
def _without_pyvista() -> tempfile.TemporaryDirectory[str]:
    """A folder whose pyvista comes before the one that is installed, and ends who loads it; it goes with the tests."""
    folder = tempfile.TemporaryDirectory()
    Path(folder.name, "pyvista.py").write_text("import os\nos._exit(1)\n")
    return folder


@contextmanager
def planner(folder: Path, *options: str, surfaces: bool = False) -> Iterator[Planner]:
    running = Planner(folder, *options, surfaces=surfaces)
    try:
        yield running
    finally:
        running.kill()


@contextmanager
def chromium(*flags: str) -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=[*FLAGS, *flags])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def looking(*flags: str) -> Iterator[Callable[..., Any]]:
    """Have functions look at pages in one tab of a browser, in the one thread that may use it."""
    with ThreadPoolExecutor(1) as thread, ExitStack() as running:
        browser = thread.submit(running.enter_context, chromium(*flags)).result()
        tab = thread.submit(browser.new_page).result()
        yield lambda look, *given: thread.submit(look, tab, *given).result()
        thread.submit(running.close).result()


def opened(browser: Any, url: str, width: int = 1280, height: int = 800, script: str = "") -> Any:
    """A tab that shows the planner whole, after a ``script``; remembers in ``page.requested`` what it asked for."""
    page = _tab(browser, script)
    page.set_viewport_size({"width": width, "height": height})
    page.requested = []
    page.goto(url)
    wait_until_whole(page)
    return page


def _tab(browser: Any, script: str) -> Any:
    """An empty tab: one that was left, or a new one with its ``script``."""
    left = [page for context in browser.contexts for page in context.pages if getattr(page, "is_left", False)]
    if left and not script:
        left[0].is_left = False
        return left[0]
    page = browser.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.add_init_script(script)
    page.may_be_left, page.is_left = not script, False
    page.on("request", lambda request: page.requested.append(request.url))
    page.on("websocket", lambda socket: page.requested.append(socket.url))
    return page


def is_left(context: Any) -> bool:
    """Whether nobody uses what the tabs of a window show."""
    return all(getattr(page, "is_left", False) for page in context.pages)


def leave(context: Any) -> None:
    """Empty a tab that was `opened` for the next test: a new one takes a browser more than the planner's page does.

    Any other is closed.
    """
    if not all(getattr(page, "may_be_left", False) for page in context.pages):
        context.close()
        return
    for page in context.pages:
        if page.is_left:  # and was not opened since
            continue
        page.evaluate("localStorage.clear()")
        page.goto("about:blank")
        page.mouse.move(0, 0)
        page.is_left = True
    context.clear_cookies()


@contextmanager
def kept_open(browser: Any, url: str) -> Iterator[Any]:
    """A tab that shows the planner to several tests, left then."""
    page = opened(browser, url)
    yield page
    leave(page.context)


def wait_until_whole(page: Any) -> None:
    page.wait_for_selector("canvas[data-picture=axial][data-number]")
    page.wait_for_selector(".rp-tab")  # the panels follow the first pictures


def place(page: Any, view: str, across: float, down: float) -> tuple[float, float]:
    """Pixels of a place given as shares of the view, from its top left."""
    box = page.locator(f"[data-view={view}]").bounding_box()
    return box["x"] + across * box["width"], box["y"] + down * box["height"]


def last_target(page: Any, view: str) -> tuple[float, float]:
    """Pixels of the last trajectory's target."""
    box = page.locator(f"svg[data-view={view}] > g > circle[fill]").last.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def fields(page: Any, which: str) -> list[float]:
    return [float(page.input_value(f"#{which}-{axis}")) for axis in "xyz"]


def eventually(page: Any, holds: Callable[[], bool]) -> None:
    """Wait until something holds, as a person would, and fail where it never does."""
    for _ in range(PATIENCE_MS // POLLING_MS):
        if holds():
            return
        page.wait_for_timeout(POLLING_MS)
    raise AssertionError("what was waited for did not come to pass")


def settled(page: Any, folder: Path, name: str, which: str, before: list[float]) -> list[float]:
    """Wait until the fields have changed and the plan file says the same millimetres."""

    def same() -> bool:
        written = getattr(read_plan(folder / "plan.json").trajectory(name), f"{which}_mm")
        shown = fields(page, which)
        return shown != before and np.allclose(shown, written, rtol=0, atol=0.0006)

    eventually(page, same)
    return fields(page, which)


def crosshair(folder: Path) -> list[float]:
    """Where the planner keeps that it looks (LPS mm); written a little after the page shows it."""
    kept = folder / "planner.json"
    return list(json.loads(kept.read_text())["crosshair"]) if kept.is_file() else []


def at_rest(page: Any, screenshot: Callable[[], bytes]) -> np.ndarray:
    """What a ``screenshot`` of a page, or of a place in it, shows (H, W, 3; blue first) once it stands still."""
    before = b""
    while (shot := screenshot()) != before:
        before = shot
        page.wait_for_timeout(300)
    return np.asarray(cv2.imdecode(np.frombuffer(shot, dtype=np.uint8), cv2.IMREAD_COLOR), dtype=int)


def value(page: Any, name: str) -> Any:
    """What the page was told under a name."""
    return page.evaluate("name => window.trame.state.get(name)", name)


def seen_at(page: Any, view: str, halves: tuple[float, float]) -> tuple[float, float]:
    """Pixels of a place in a view, given in halves of its picture."""
    box = page.locator(f"[data-view={view}]").bounding_box()
    half = min(box["width"], box["height"]) / 2
    return box["x"] + box["width"] / 2 + halves[0] * half, box["y"] + box["height"] / 2 + halves[1] * half


def with_head(page: Any) -> Any:
    """Wait until the 3-D view shows something."""
    page.wait_for_function("window.trame.state.get('picture_head')", polling=POLLING_MS)
    page.wait_for_function("window.trame.state.get('drawn_head').paths.length", polling=POLLING_MS)
    return page
