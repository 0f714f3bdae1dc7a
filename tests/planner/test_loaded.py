"""The planner's memory is the scan's, not its libraries': what is not needed to look and measure is not loaded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests import cases
from tests.planner.browser import environment

SCRIPT = """
import sys
import numpy as np
from trame.app import get_server
from ronnaplan.ct import read_ct
from ronnaplan.planner.app import PlannerApp
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage

volume = read_ct(sys.argv[1])
vessel = np.zeros(volume.voxels_hu.shape, dtype=bool)
vessel[-20:-10, 60:70, 60:70] = True
state = PlannerState(volume, Storage.of(sys.argv[2], None, None), no_go={"vessel": vessel})
app = PlannerApp(state, get_server("test", client_type="vue3"))
app.head.load()
assert not app.head.wanting
app.head.open()
app.painter.measured_against, app.painter.pictures = state.case.surroundings, True
state.case.begin_drag("left")
state.case.drag("left", "target", state.case.plan.trajectory("left").target_mm + 1.0)
app.refresh()
state.case.end_drag()
app.refresh()
assert state.case.judge(state.look.chosen).measures.skull_thickness_mm > 1.0
assert any(one.name == "vessel" for one in state.case.judge(state.look.chosen).measures.clearances)
assert app.server.state.picture_head and app.server.state.picture_axial
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
