"""Scans as hospitals make them: named protocols whose settings vary with a seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from phantoms.cone_beam import ConeBeam, Turn
from phantoms.errors import PhantomError
from phantoms.fast import Renderer
from phantoms.finish import (
    Finish,
    Interpolated,
    NonLocalMeans,
    PenalizedLeastSquares,
    Reformatted,
    Step,
    TotalVariation,
)
from phantoms.helix import Helix
from phantoms.helix_settings import Method
from phantoms.machine import Machine
from phantoms.motion import random_motion
from phantoms.profiles import Shape
from phantoms.scanner import Scanner
from phantoms.series import Tag
from phantoms.solids import FloatArray

TAGS: tuple[Tag, ...] = ("nominal", "nominal", "spacing", "pixel", "doubled", "absent")
"""What is drawn from where a protocol does not say what the header says of the thickness."""
THIN_MM = (0.6, 0.75, 1.0, 1.25)
"""Nominal thicknesses of thin slices."""
BROADENING = (1.05, 1.5)
"""Full widths at half maximum over the nominal thickness, as published for helical scanners."""
FOUR_ROWS_MM = (1.0, 1.25)
SLOW = (0.5, 0.78)
"""Row heights and pitches of scanners with four rows."""


@dataclass(frozen=True)
class Protocol:
    """How a scan is acquired, reconstructed, spaced, finished and tagged."""

    name: str
    scanner: Machine
    thickness_mm: float
    spacing_mm: float
    finish: Finish = field(default_factory=Finish)
    orientation: FloatArray = field(default_factory=lambda: np.eye(3))
    """Turns the slices (3, 3) against the patient's axes."""
    cubic: bool = False
    """Whether a voxel's edges are all as long as the slices are thick."""

    def scanner_at(self, dose: float) -> Machine:
        """Return the scanner at ``dose`` times its own dose."""
        return replace(self.scanner, dose=dose * self.scanner.dose)


Generator = np.random.Generator
Maker = Callable[[str, Generator], Protocol]


def _tag(generator: Generator) -> Tag:
    return TAGS[generator.integers(len(TAGS))]


def _axial(
    kernels: tuple[str, ...] = ("soft", "smooth", "standard", "detail"),
    thicknesses_mm: tuple[float, ...] = THIN_MM,
    spacing: float = 1.0,
    slope: float = 1.0,
    step: Callable[[Generator], Step] | None = None,
    moves: bool = False,
) -> Maker:
    """Make axial scans; ``spacing`` is a multiple of the thickness."""

    def make(name: str, generator: Generator) -> Protocol:
        thickness = float(generator.choice(thicknesses_mm))
        scanner = Scanner(kernel=str(generator.choice(kernels)))
        finish = Finish(() if step is None else (step(generator),), slope, _tag(generator))
        scanner = replace(scanner, motion=random_motion(generator)) if moves else scanner
        return Protocol(name, scanner, thickness, spacing * thickness, finish)

    return make


def _penalized(generator: Generator) -> Step:
    return PenalizedLeastSquares(float(generator.uniform(0.2, 0.35)), float(generator.uniform(15, 60)))


def _interpolated(thickness_mm: float, spacing_mm: float) -> Maker:
    """Make slices of ``thickness_mm``, reconstructed touching, then interpolated every ``spacing_mm``."""

    def make(name: str, generator: Generator) -> Protocol:
        scanner = Scanner(kernel=str(generator.choice(["soft", "standard", "detail"])))
        finish = Finish((Interpolated(thickness_mm),), tag=_tag(generator))
        return Protocol(name, scanner, thickness_mm, spacing_mm, finish)

    return make


def _oblique(name: str, generator: Generator) -> Protocol:
    native = float(generator.choice([0.6, 0.75, 1.0]))
    angles = generator.uniform(8, 25, 2) * generator.choice([-1, 1], 2)
    turn = Rotation.from_euler("xy", angles, degrees=True).as_matrix()
    scanner = Scanner(kernel=str(generator.choice(["soft", "standard", "detail"])))
    thickness = float(generator.choice([0.8, 1.0, 1.5]))
    finish = Finish((Reformatted(native, native),), tag=_tag(generator))
    return Protocol(name, scanner, thickness, thickness, finish, turn)


def _helix(
    rows: int,
    rows_mm: tuple[float, ...],
    pitches: tuple[float, float],
    method: Method = "WFBP",
    thicknesses: tuple[float, ...] = (1.0,),
    kernels: tuple[str, ...] = ("soft", "smooth", "standard", "detail"),
    step: Callable[[Generator], Step] | None = None,
    moves: bool = False,
) -> Maker:
    """Make helical scans; thicknesses are multiples of the row height, slices overlap by up to a half."""

    def make(name: str, generator: Generator) -> Protocol:
        row = float(generator.choice(rows_mm))
        flying = bool(generator.random() < 0.5)
        scanner = Helix(
            kernel=str(generator.choice(kernels)),
            rows=rows,
            row_mm=row,
            pitch=round(float(generator.uniform(*pitches)), 3),
            method=method,
            views=1152 if flying else 960,
            spot_mm=(round(float(generator.uniform(0.5, 1.0)), 2), round(float(generator.uniform(0.5, 1.0)), 2)),
            flying_spot=flying,
            start_deg=round(float(generator.uniform(0, 360)), 1),
        )
        scanner = replace(scanner, motion=random_motion(generator)) if moves else scanner
        thickness = round(row * float(generator.choice(thicknesses)), 3)
        spacing = round(thickness * float(generator.choice([0.5, 2 / 3, 0.8, 1.0])), 3)
        finish = Finish(() if step is None else (step(generator),), tag=_tag(generator))
        return Protocol(name, scanner, thickness, spacing, finish)

    return make


def _rendered(shape: Shape) -> Maker:
    def make(name: str, generator: Generator) -> Protocol:
        thickness = float(generator.choice([0.5, *THIN_MM, 2.0, 3.0]))
        renderer = Renderer(
            kernel=str(generator.choice(["very soft", "soft", "standard", "bone"])),
            shape=shape,
            broadening=float(generator.uniform(*BROADENING)),
        )
        return Protocol(name, renderer, thickness, thickness, Finish(tag=_tag(generator)))

    return make


def _cone(
    turn: Turn = "full",
    lag: tuple[float, float] = (0.0, 0.0),
    width_mm: tuple[float, float] = (300.0, 300.0),
    moves: bool = False,
) -> Maker:
    """Make cone-beam scans; scale and offset of their values depart from Hounsfield's."""

    def make(name: str, generator: Generator) -> Protocol:
        voxel = float(generator.choice([0.3, 0.4, 0.5]))
        scanner = ConeBeam(
            kernel=str(generator.choice(["smooth", "standard", "detail"])),
            dose=float(generator.uniform(0.3, 0.8)),
            kilovolts=float(generator.choice([90.0, 100.0, 110.0, 120.0])),
            views=int(generator.choice([400, 480, 560])),
            turn=turn,
            width_mm=float(generator.uniform(*width_mm)),
            source_mm=float(generator.uniform(580, 780)),
            start_deg=float(generator.uniform(0, 360)),
            scatter=float(generator.uniform(0.02, 0.12)),
            lag=float(generator.uniform(*lag)),
            hu_scale=float(generator.uniform(0.8, 1.2)),
            hu_offset=float(generator.uniform(-20, 100)),
        )
        scanner = replace(scanner, motion=random_motion(generator)) if moves else scanner
        tag: Tag = "absent" if generator.random() < 0.3 else "nominal"
        return Protocol(name, scanner, voxel, voxel, Finish(tag=tag), cubic=True)

    return make


PROTOCOLS: dict[str, tuple[str, Maker]] = {
    "axial": ("axial, thin touching slices, usual kernels", _axial()),
    "axial very soft": ("the same with a very soft kernel", _axial(("very soft",))),
    "axial bone": ("the same with a sharp kernel", _axial(("bone",))),
    "axial edge": ("the same with a kernel that overshoots at edges", _axial(("edge", "strong edge"))),
    "axial total variation": (
        "the same, denoised by total variation",
        _axial(step=lambda generator: TotalVariation(float(generator.uniform(8, 30)))),
    ),
    "axial non-local means": (
        "the same, denoised by non-local means",
        _axial(step=lambda generator: NonLocalMeans(float(generator.uniform(6, 15)))),
    ),
    "axial penalized": (
        "the same, reconstructed by penalized least squares",
        _axial(("plain",), step=_penalized),
    ),
    "axial slope 2": ("the same, stored in steps of 2 HU", _axial(slope=2.0)),
    "axial overlapping": ("thin slices every half thickness", _axial(spacing=0.5)),
    "axial motion": ("the patient jumps, drifts, turns or breathes meanwhile", _axial(moves=True)),
    "axial gapped": (
        "2 to 3 mm slices with gaps of a third",
        _axial(thicknesses_mm=(2.0, 2.5, 3.0), spacing=4 / 3),
    ),
    "1.5 mm every 0.5 mm": ("1.5 mm slices, interpolated every 0.5 mm", _interpolated(1.5, 0.5)),
    "3 mm": ("touching 3 mm slices", _axial(thicknesses_mm=(3.0,))),
    "5 mm every 2.5 mm": ("overlapping 5 mm slices", _axial(thicknesses_mm=(5.0,), spacing=0.5)),
    "5 mm": ("touching 5 mm slices", _axial(thicknesses_mm=(5.0,))),
    "helix 4 x 1.25, 180LI": (
        "four rows, interpolated between half turns",
        _helix(4, FOUR_ROWS_MM, SLOW, "180LI"),
    ),
    "helix 4 x 1.25, 360LI": (
        "four rows, interpolated between whole turns",
        _helix(4, FOUR_ROWS_MM, SLOW, "360LI"),
    ),
    "helix 16 x 0.75": ("16 rows, weighted filtered back-projection", _helix(16, (0.6, 0.75), (0.5, 0.8))),
    "helix 32 x 0.6": ("the same, 32 rows", _helix(32, (0.5, 0.6), (0.45, 0.6))),
    "helix 64 x 0.6": ("the same, 64 rows", _helix(64, (0.5, 0.6), (0.54, 0.58))),
    "helix motion": (
        "32 rows; the patient jumps, drifts, turns or breathes meanwhile",
        _helix(32, (0.5, 0.6), (0.45, 0.6), moves=True),
    ),
    "helix 32 x 0.6, thick": (
        "the same, slices of 2 to 8 rows",
        _helix(32, (0.6,), (0.45, 0.6), thicknesses=(2, 5, 8)),
    ),
    "helix 32 x 0.6, edge": (
        "the same, kernels that overshoot at edges",
        _helix(32, (0.6,), (0.45, 0.6), kernels=("bone", "edge", "strong edge")),
    ),
    "helix 32 x 0.6, denoised": (
        "the same, denoised by total variation",
        _helix(32, (0.6,), (0.45, 0.6), step=lambda generator: TotalVariation(float(generator.uniform(8, 30)))),
    ),
    "helix 32 x 0.6, fast": (
        "the same with the table at twice the speed, where the method itself displaces by up to 0.02 mm",
        _helix(32, (0.6,), (0.8, 1.2)),
    ),
    "oblique": ("reformatted to slices 8 to 25 degrees off the axial ones", _oblique),
    "cone beam": ("cone beam on a flat panel, full turn, cubic voxels, values of their own scale", _cone()),
    "cone beam short": ("the same, half a turn and the fan", _cone("short")),
    "cone beam lag": ("full turn; the panel keeps a part of what it saw before", _cone(lag=(0.5, 1.5))),
    "cone beam truncated": ("full turn; the panel is narrower than the head", _cone(width_mm=(225.0, 260.0))),
    "cone beam motion": ("full turn; the patient jumps, drifts, turns or breathes meanwhile", _cone(moves=True)),
    "rendered gaussian": ("fast renderer, Gaussian profile broader than nominal", _rendered("gaussian")),
    "rendered trapezoid": ("fast renderer, trapezoidal profile broader than nominal", _rendered("trapezoid")),
    "rendered triangle": ("fast renderer, triangular profile broader than nominal", _rendered("triangle")),
}
"""Protocols by name: what they are, and their maker from a random generator."""


def draw(name: str, seed: int) -> Protocol:
    """Return the protocol called ``name`` with settings drawn from ``seed``; raises `PhantomError` with the names."""
    if name not in PROTOCOLS:
        raise PhantomError(f"no protocol is called {name!r}; expected one of {'; '.join(PROTOCOLS)}")
    return PROTOCOLS[name][1](name, np.random.default_rng([seed, 20260202]))
