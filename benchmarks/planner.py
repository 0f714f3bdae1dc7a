"""The planner through a browser of 1920 x 1080: time to the first picture and the 3-D scene, to answer steps; memory.

    python -m benchmarks.planner [FOLDER] [--steps 40]

Without a folder a head is rendered: 190 uncompressed slices of 512 x 512. Needs Chromium and the package playwright.
A step is timed in the page, from the event until the frame is painted in which there is a new picture (scroll, window)
or the end at its new place (drag); when the frame after it begins is told, too. Measures and 3-D view follow a drag
beside it: the processor's time of a step counts them. The browser is forbidden to draw in 3-D itself, for without a
graphics card that would take the server's processors: the server draws the head, as it does for such browsers, which is
more work than it has with any other.

Memory is that of the server, the only process there is: its peak as the kernel keeps it (resident, libraries' files
included), the largest seen share of it with shared pages divided among their users (proportional) and not counted
(private), and what a server takes that shows the small scan of the demo, less that scan's voxels: interpreter,
libraries and everything that does not grow with the scan.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.pipeline import make_series
from phantoms.library import demo_head
from ronnaplan.ct import read_ct

FIRST_PICTURE_S, SCENE_S, STEP_MS, DRAG_MS, MEMORY = 1.5, 3.0, 33.0, 40.0, 3.0
"""Goals; memory as a multiple of the voxels."""

WIDE, HIGH = 1920, 1080

SCENE_SHOWN = "(window.trame.state.get('things') ?? []).some((one) => one.name === 'skin')"

WATCH_S = 0.05
"""Memory is looked at so often."""

RIGHT_BUTTON = 2

SMALL = Path(__file__).resolve().parents[1] / "data" / "synthetic_ct"
FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-3d-apis", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)

TELL = "([name, args]) => window.trame.trigger(name, args)"
"""Has the planner do something, and waits until it is done."""

DRAWN = """async ([name, key, args]) => {
  const read = () => key === 'axial' ? document.querySelector('canvas[data-picture=axial]').dataset.number
                                     : JSON.stringify(window.trame.state.get('drawn_axial').paths);
  const before = read(), start = performance.now();
  const reply = window.trame.trigger(name, args);
  while (read() === before && performance.now() - start < 5000) await new Promise(requestAnimationFrame);
  const channel = new MessageChannel(), next = new Promise(requestAnimationFrame);
  const painted = new Promise((done) => (channel.port1.onmessage = done));
  channel.port2.postMessage(0); // told once this frame is painted
  await painted;
  const shown = performance.now() - start;
  await next;
  const after = performance.now() - start;
  await reply;
  return [shown, after];
}"""


@dataclass
class Memory:
    """Largest memory of a process, in bytes."""

    resident: int = 0
    proportional: int = 0
    private: int = 0


@dataclass
class Figures:
    """What one run of the planner took."""

    first_picture_s: float = 0.0
    first_picture_cpu_s: float = 0.0
    scene_s: float = 0.0
    scene_cpu_s: float = 0.0
    scroll_ms: float = 0.0
    scroll_next_ms: float = 0.0
    scroll_cpu_ms: float = 0.0
    window_ms: float = 0.0
    window_next_ms: float = 0.0
    window_cpu_ms: float = 0.0
    drag_ms: float = 0.0
    drag_next_ms: float = 0.0
    drag_cpu_ms: float = 0.0
    memory: Memory = field(default_factory=Memory)


def main() -> int:
    """Print the table; return 1 if a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--steps", type=int, default=40)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or make_series(Path(scratch) / "ct", demo_head(), slices=190, spacing_mm=1.0)
        voxels, few = read_ct(folder).voxels_hu, read_ct(SMALL).voxels_hu.nbytes
        small = run(SMALL, Path(scratch), 3).memory
        figures = run(folder, Path(scratch), arguments.steps)
    size, peak = voxels.nbytes, figures.memory
    shape = " x ".join(str(size) for size in voxels.shape)
    print(f"{shape} voxels, {size / 1e6:.0f} MB; load {os.getloadavg()[0]:.1f}")
    rows = [
        ("first picture, reading included, s", figures.first_picture_s, FIRST_PICTURE_S),
        ("  CPU time until then, s", figures.first_picture_cpu_s, None),
        ("3-D scene after that, s", figures.scene_s, SCENE_S),
        ("  CPU time until then, s", figures.scene_cpu_s, None),
        ("scroll step, painted, median ms", figures.scroll_ms, STEP_MS),
        ("  the frame after it begins, ms", figures.scroll_next_ms, None),
        ("  CPU time of the server, ms", figures.scroll_cpu_ms, None),
        ("window step, painted, median ms", figures.window_ms, STEP_MS),
        ("  the frame after it begins, ms", figures.window_next_ms, None),
        ("  CPU time of the server, ms", figures.window_cpu_ms, None),
        ("drag step, painted, median ms", figures.drag_ms, DRAG_MS),
        ("  the frame after it begins, ms", figures.drag_next_ms, None),
        ("  CPU time of the server, ms", figures.drag_cpu_ms, None),
        ("peak memory, resident, MB", peak.resident / 1e6, None),
        ("peak memory, resident, x voxels", peak.resident / size, MEMORY),
        ("  proportional, x voxels", peak.proportional / size, None),
        ("  private, x voxels", peak.private / size, None),
        ("  less that of a small scan, x voxels", (peak.resident - small.resident) / size, None),
        ("  interpreter and libraries, resident, MB", (small.resident - few) / 1e6, None),
        ("  interpreter and libraries, private, MB", (small.private - few) / 1e6, None),
    ]
    for name, value, goal in rows:
        aim = "" if goal is None else f"   goal {goal:g}{'' if value <= goal else '   MISSED'}"
        print(f"{name:50}{value:9.2f}{aim}")
    return 0 if all(goal is None or value <= goal for _, value, goal in rows) else 1


def run(ct: Path, scratch: Path, steps: int) -> Figures:
    """Open the planner on ``ct`` and use it."""
    from playwright.sync_api import sync_playwright

    case = Path(tempfile.mkdtemp(dir=scratch))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        page = browser.new_page(viewport={"width": WIDE, "height": HIGH})
        started = time.perf_counter()
        command = [sys.executable, "-m", "ronnaplan", "view", str(ct), "--plan", str(case / "plan.json")]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        figures = Figures()
        try:
            assert server.stdout is not None
            with watched(server.pid, figures.memory):
                page.goto(server.stdout.readline().strip())
                page.wait_for_selector("canvas[data-picture=axial][data-number]", timeout=120_000)
                figures.first_picture_s = time.perf_counter() - started
                spent = cpu_ms(server.pid)
                figures.first_picture_cpu_s = spent / 1e3
                page.wait_for_function(SCENE_SHOWN, timeout=120_000)
                figures.scene_s = time.perf_counter() - started - figures.first_picture_s
                figures.scene_cpu_s = (cpu_ms(server.pid) - spent) / 1e3
                page.wait_for_timeout(1000)  # pictures at rest are drawn, and all trajectories measured
                spent = cpu_ms(server.pid)
                figures.scroll_ms, figures.scroll_next_ms = scrolled(page, steps)
                figures.scroll_cpu_ms, spent = (cpu_ms(server.pid) - spent) / steps, cpu_ms(server.pid)
                figures.window_ms, figures.window_next_ms = windowed(page, steps)
                figures.window_cpu_ms, spent = (cpu_ms(server.pid) - spent) / steps, cpu_ms(server.pid)
                figures.drag_ms, figures.drag_next_ms = dragged(page, steps)
                figures.drag_cpu_ms = (cpu_ms(server.pid) - spent) / steps
            return figures
        finally:
            server.kill()
            server.communicate()
            browser.close()


def scrolled(page: Any, steps: int) -> tuple[float, float]:
    """Median times of a scroll in the axial view: until it is painted, and until the frame after that."""
    one = ["wheel", "axial", ["axial", 1, False, 150, 150, 300, 300]]
    return medians(page, [one] * steps)


def windowed(page: Any, steps: int) -> tuple[float, float]:
    """The same of a step of the window's level in the axial view."""
    size = [600, 600]
    page.evaluate(TELL, ["press", ["axial", 300, 300, *size, RIGHT_BUTTON, False]])
    found = medians(page, [["move", "axial", ["axial", 300 + n, 300, *size]] for n in range(1, steps + 1)])
    page.evaluate(TELL, ["release", ["axial"]])
    return found


def dragged(page: Any, steps: int) -> tuple[float, float]:
    """The same of one move of a trajectory's target."""
    size = [300, 300]
    page.evaluate(TELL, ["key", ["a"]])
    page.evaluate(TELL, ["press", ["axial", 200, 150, *size, 0, False]])
    page.evaluate(TELL, ["press", ["axial", 150, 160, *size, 0, False]])
    page.evaluate(TELL, ["press", ["axial", 150, 160, *size, 0, False]])
    found = medians(page, [["move", "target", ["axial", 150 + n % 40, 160, *size]] for n in range(1, steps + 1)])
    page.evaluate(TELL, ["release", ["axial"]])
    return found


def medians(page: Any, events: list[list[Any]]) -> tuple[float, float]:
    """Median times until what each event does is painted, and until the frame after that."""
    taken = [page.evaluate(DRAWN, event) for event in events]
    return median(painted for painted, _ in taken), median(after for _, after in taken)


@contextmanager
def watched(pid: int, memory: Memory) -> Iterator[None]:
    """Keep the largest memory of a process in ``memory`` while it is used."""
    done = threading.Event()

    def watch() -> None:
        while not done.wait(WATCH_S):
            now = kilobytes(Path(f"/proc/{pid}/smaps_rollup"))
            memory.proportional = max(memory.proportional, 1024 * now["Pss"])
            memory.private = max(memory.private, 1024 * (now["Private_Clean"] + now["Private_Dirty"]))

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        memory.resident = 1024 * kilobytes(Path(f"/proc/{pid}/status"))["VmHWM"]


def kilobytes(table: Path) -> dict[str, int]:
    """Return the entries of one of the kernel's tables that are in kB."""
    rows = (line.split() for line in table.read_text().splitlines())
    return {row[0].rstrip(":"): int(row[1]) for row in rows if row[-1] == "kB"}


def cpu_ms(pid: int) -> float:
    """Return the CPU time that a process has used, all its threads together, and those it started that have ended."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return 1e3 * sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    raise SystemExit(main())
