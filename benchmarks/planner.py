"""The planner through a browser: time to the first picture, to answer a scroll and a drag, and its memory.

    python -m benchmarks.planner [FOLDER] [--steps 40]

Without a folder a head is rendered: 190 uncompressed slices of 512 x 512. Needs Chromium and the package playwright.
A step is timed in the page, from the event until a new picture (scroll) or the end at its new place (drag) has been
drawn; of a drag also until the measures have followed, when the page sends the next step.
Memory is the server's peak, as it is and less that of a server that shows the small scan of the demo.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.pipeline import make_series
from ronnaplan.ct import read_ct

FIRST_PICTURE_S, STEP_MS, MEMORY = 5.0, 100.0, 3.0
"""Goals; memory as a multiple of the voxels."""

SMALL = Path(__file__).resolve().parents[1] / "data" / "synthetic_ct"
FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)

DRAWN = """async ([name, key, args]) => {
  const read = () => JSON.stringify(key === 'axial' ? window.trame.state.get('picture_axial')
                                                    : window.trame.state.get('drawn_axial').paths);
  const before = read(), start = performance.now();
  const reply = window.trame.trigger(name, args);
  while (read() === before && performance.now() - start < 5000) await new Promise(requestAnimationFrame);
  await new Promise(requestAnimationFrame);
  const shown = performance.now() - start;
  await reply;
  return [shown, performance.now() - start];
}"""


@dataclass(frozen=True)
class Figures:
    """What one run of the planner took."""

    first_picture_s: float
    scroll_ms: float
    drag_ms: float
    measured_ms: float
    peak_bytes: int


def main() -> int:
    """Print the table; return 1 if a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--steps", type=int, default=40)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or make_series(Path(scratch) / "ct")
        voxels = read_ct(folder).voxels_hu
        small = run(SMALL, Path(scratch), 3)
        figures = run(folder, Path(scratch), arguments.steps)
    total, added = (
        bytes_ / voxels.nbytes for bytes_ in (figures.peak_bytes, figures.peak_bytes - small.peak_bytes)
    )
    shape = " x ".join(str(size) for size in voxels.shape)
    print(f"{shape} voxels, {voxels.nbytes / 1e6:.0f} MB")
    rows = [
        ("first picture, reading included, s", figures.first_picture_s, FIRST_PICTURE_S),
        ("scroll step, median ms", figures.scroll_ms, STEP_MS),
        ("drag step, median ms", figures.drag_ms, STEP_MS),
        ("drag step with measures, median ms", figures.measured_ms, STEP_MS),
        ("memory, all of the server, x voxels", total, MEMORY),
        ("memory, less that of a small scan, x voxels", added, MEMORY),
    ]
    for name, value, goal in rows:
        print(f"{name:46}{value:9.2f}   goal {goal:g}{'' if value <= goal else '   MISSED'}")
    return 0 if all(value <= goal for _, value, goal in rows) else 1


def run(ct: Path, scratch: Path, steps: int) -> Figures:
    """Open the planner on ``ct`` and use it."""
    from playwright.sync_api import sync_playwright

    case = Path(tempfile.mkdtemp(dir=scratch))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        started = time.perf_counter()
        command = [sys.executable, "-m", "ronnaplan", "view", str(ct), "--plan", str(case / "plan.json")]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            assert server.stdout is not None
            page.goto(server.stdout.readline().strip())
            page.wait_for_selector("svg[data-view=axial] image", timeout=120_000)
            first = time.perf_counter() - started
            page.wait_for_function("window.trame.state.get('picture_head')", timeout=120_000)
            return Figures(first, scrolled(page, steps), *dragged(page, steps), peak_bytes(server.pid))
        finally:
            server.kill()
            server.communicate()
            browser.close()


def scrolled(page: Any, steps: int) -> float:
    """Median time of a scroll in the axial view."""
    one = ["wheel", "axial", ["axial", 1, False, 150, 150, 300, 300]]
    return float(median(page.evaluate(DRAWN, one)[0] for _ in range(steps)))


def dragged(page: Any, steps: int) -> tuple[float, float]:
    """Median time of one move of a trajectory's target: until it is drawn, and until it is measured."""
    tell = "([name, args]) => window.trame.trigger(name, args)"
    size = [300, 300]
    page.evaluate(tell, ["key", ["a"]])
    page.evaluate(tell, ["press", ["axial", 200, 150, *size, 0, False]])
    page.evaluate(tell, ["press", ["axial", 150, 160, *size, 0, False]])
    page.evaluate(tell, ["press", ["axial", 150, 160, *size, 0, False]])
    moves = [["move", "target", ["axial", 150 + n % 40, 160, *size]] for n in range(1, steps + 1)]
    taken = [page.evaluate(DRAWN, move) for move in moves]
    page.evaluate(tell, ["release", ["axial"]])
    return median(shown for shown, _ in taken), median(answered for _, answered in taken)


def peak_bytes(pid: int) -> int:
    """Peak resident memory of a process."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return 1024 * int(line.split()[1])
    raise ProcessLookupError(pid)


if __name__ == "__main__":
    raise SystemExit(main())
