"""What stands out of a head is known by its voxels; what the head lies on is not taken for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from phantoms.stack import axial_stack
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Head
from ronnaplan.planning.beside import beside
from tests.long import few_and_others
from tests.scans import offsets_mm, on_grid

HALF_AXES_MM = np.array([66.0, 80.0, 74.0])
NOISE_HU, FINE_NOISE_HU = 90.0, 200.0
SIDEWAYS = Rotation.from_euler("x", -90, degrees=True).as_matrix()
STACKS: dict[str, dict[str, object]] = {
    "axial": {"spacing_mm": 3.0},
    "from crown to feet": {"spacing_mm": 3.0, "orientation": np.diag([1.0, -1.0, -1.0])},
    "coronal": {"spacing_mm": 3.0, "orientation": SIDEWAYS},
    "thick and tilted": {"spacing_mm": 4.0, "tilt_deg": 15.0},
    "fine and noisy": {"spacing_mm": 3.0, "matrix": 380},
}


def lying(stack: str) -> tuple[Head, FloatArray, FloatArray]:
    """Return a head in a shell that goes on to the table, the voxels of a thin post and a bar, and the shell's."""
    settings = {"matrix": 180, "field_of_view_mm": 190.0, "start_mm": -95, "stop_mm": 95, **STACKS[stack]}
    slices = axial_stack(**settings)  # type: ignore[arg-type]
    empty = on_grid(np.zeros((len(slices), slices.rows, slices.columns), dtype=np.int16), slices)
    x, y, z = offsets_mm(empty, np.zeros(3))
    places = np.stack([x, y, z], axis=-1)
    head = (places**2 / HALF_AXES_MM**2).sum(axis=-1) <= 1.0
    post = (np.hypot(x - 10.0, z - 10.0) <= 1.5) & (y > -95.0) & (y < -70.0)
    bar = (np.hypot(y + 20.0, z - 80.0) <= 3.0) & (np.abs(x) < 40.0)
    shell = (np.hypot(x, y) > 86.0) & (np.hypot(x, y) < 91.0) & (y > 0.0) & (z < 30.0)
    images = np.where(head | post | bar | shell, 40.0, -1000.0)
    noise_hu = FINE_NOISE_HU if slices.pixel_mm < 1.0 else NOISE_HU
    images += np.random.default_rng(1).normal(scale=noise_hu, size=images.shape)
    scanned = Head.of(replace(empty, voxels_hu=images.astype(np.int16)))
    apart = (places**2 / (HALF_AXES_MM + 6.0) ** 2).sum(axis=-1) > 1.0
    return scanned, places[(post | bar) & apart], places[shell]


@few_and_others("stack", ["coronal", "thick and tilted"], ["axial", "from crown to feet", "fine and noisy"])
def test_posts_and_bars_are_covered_but_not_what_goes_on_to_the_table(stack: str) -> None:
    head, standing_mm, shell_mm = lying(stack)
    balls = beside(head)
    assert len(standing_mm) > 20
    away_mm = np.linalg.norm(standing_mm[:, None] - balls[:, :3], axis=2)
    assert (away_mm <= balls[:, 3]).any(axis=1).all()
    of_crown = (balls[:, :3] ** 2 / HALF_AXES_MM**2).sum(axis=1) <= 1.02  # too narrow there for the scalp's cells
    assert away_mm[:, ~of_crown].min(axis=0).max() < 8.0
    assert np.linalg.norm(balls[:, None, :3] - shell_mm[::7], axis=2).min() > 10.0
