"""The planner's memory is the scan's, not its libraries': what is not needed to look and measure is not loaded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests import cases
from tests.planner.browser import environment

SCRIPT = """
import sys
import numpy as np
import asyncio
from trame.app import get_server
from ronnaplan.ct import read_ct
from ronnaplan.planner import app as planner_app
from ronnaplan.planner.app import PlannerApp
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage

planner_app.MOST_TRIANGLES = 10**6  # to thin surfaces out takes most of the time, in another process than this one
volume = read_ct(sys.argv[1])
vessel = np.zeros(volume.voxels_hu.shape, dtype=bool)
vessel[-20:-10, 60:70, 60:70] = True
state = PlannerState(volume, Storage.of(sys.argv[2], None, None), no_go={"vessel": vessel})
app = PlannerApp(state, get_server("test", client_type="vue3"))

async def use():
    app.opened("one", lambda values: None)
    await asyncio.gather(app._wake(), app._make_head())
    assert not app.parts.wanting
    (tab,) = app.tabs.values()
    tab.painter.pictures = True
    while not app.judging.is_done():
        await asyncio.sleep(0.1)
    state.case.begin_drag("left")
    state.case.drag("left", "target", state.case.plan.trajectory("left").target_mm + 1.0)
    app.refresh()
    state.case.end_drag()
    app.refresh()
    assert tab.shown["picture_head"] and tab.shown["picture_axial"]

asyncio.run(use())
assert state.case.judge(state.look.chosen).measures.skull_thickness_mm > 1.0
assert any(one.name == "vessel" for one in state.case.judge(state.look.chosen).measures.clearances)
print(*sorted({name.partition(".")[0] for name in sys.modules}))
"""

TOO_HEAVY = {"numba", "llvmlite", "vtk", "vtkmodules", "pyvista", "matplotlib", "SimpleITK", "pandas"}
"""Of pydicom nothing is said: this scan is compressed, and its decoders are pydicom's."""


def test_looking_dragging_and_measuring_load_no_compiler_and_no_graphics_library(tmp_path: Path) -> None:
    cases.write_case(tmp_path)
    command = [sys.executable, "-c", SCRIPT, str(cases.CT), str(tmp_path / "plan.json")]
    ran = subprocess.run(command, capture_output=True, text=True, env=environment(), check=False)
    assert ran.returncode == 0, ran.stderr
    loaded = set(ran.stdout.split())
    assert "cv2" in loaded  # so the names are those of modules
    assert not loaded & TOO_HEAVY


LEFT = """
import asyncio, gc, sys, weakref
from ronnaplan.ct import read_ct
from ronnaplan.planner import app
from ronnaplan.planner.address import Address
from ronnaplan.planner.server import serve
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage

watch = app.PlannerApp._watch

async def watch_and_leave(self, **ready):
    asyncio.get_running_loop().call_later(0.2, self.leave)
    await watch(self, **ready)

app.PlannerApp._watch = watch_and_leave
kept = []
for _ in range(2):
    volume = read_ct(sys.argv[1])
    kept.append(weakref.ref(volume))
    assert serve(PlannerState(volume, Storage.of(sys.argv[2], None, None)), address=Address.new())
    del volume
    gc.collect()
print(sum(one() is not None for one in kept))
"""


def test_a_case_that_was_left_is_forgotten(tmp_path: Path) -> None:
    cases.write_case(tmp_path)
    command = [sys.executable, "-c", LEFT, str(cases.CT), str(tmp_path / "plan.json")]
    ran = subprocess.run(command, capture_output=True, text=True, env=environment(), check=False)
    assert (ran.returncode, ran.stdout.strip()) == (0, "0"), ran.stderr
    assert "Traceback" not in ran.stderr


WORKING = """
import asyncio, os, signal, sys, threading, time
from functools import partial
from ronnaplan.planner import app
from ronnaplan.planner.server import serve
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.planner.worker import Job
from tests import cases

watch = app.PlannerApp._watch

async def watch_and_work(self, **ready):
    self.working.start(Job("waiting", partial(time.sleep, 300), print))
    threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGTERM)).start()
    await watch(self, **ready)

app.PlannerApp._watch = watch_and_work
serve(PlannerState(cases.volume(), Storage.of(sys.argv[1], None, None)), announce=print)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="a process is sent no signals there")
def test_a_planner_that_is_stopped_waits_for_no_work(tmp_path: Path) -> None:
    """It was there until a registration, or a search for markers, was done."""
    cases.write_case(tmp_path)
    command = [sys.executable, "-c", WORKING, str(tmp_path / "plan.json")]
    ran = subprocess.run(command, capture_output=True, text=True, env=environment(), check=False, timeout=200)
    assert ran.returncode == 0, ran.stderr
    assert "Traceback" not in ran.stderr
