"""Ready-made examinations: the scenes that tests and benchmarks share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from phantoms.anatomy import (
    SCALP_SEMI_AXES_MM,
    dental_metal,
    ear_rings,
    electrode,
    head,
    infusion_tube,
    scalp_foot,
    surroundings,
)
from phantoms.decoys import DECOYS, decoy
from phantoms.errors import PhantomError
from phantoms.examination import Examination
from phantoms.markers import marker, x_frame
from phantoms.patients import random_patient
from phantoms.scene import Part, Scene, join
from phantoms.solids import box, cylinder, ellipsoid
from phantoms.stack import axial_stack

Place = tuple[float, float, float]

DEMO_MARKERS: dict[str, Place] = {
    "M1": (-0.62, -0.55, 0.56),
    "M2": (0.45, -0.72, 0.53),
    "M3": (0.86, 0.05, 0.50),
    "M4": (0.30, 0.62, 0.72),
    "M5": (-0.55, 0.70, 0.45),
    "M6": (-0.30, 0.10, 0.95),
}
"""Directions from the head's center to the markers of ``data/synthetic_ct``."""
DEMO_DECOYS: dict[str, Place] = {
    "larger sphere": (-0.85, 0.15, 0.45),
    "cylinder": (0.05, -0.35, 0.93),
    "ellipsoid": (0.60, 0.35, 0.75),
    "capsule": (-0.75, -0.25, 0.62),
    "bare screw": (0.62, -0.38, 0.68),
}
PATIENT_MARKERS: tuple[Place, ...] = (
    (0.50, -0.58, 0.55),
    (-0.42, -0.86, 0.54),
    (-0.90, -0.16, 0.56),
    (0.91, 0.21, 0.41),
    (0.24, -0.18, 0.84),
    (-0.53, 0.58, 0.78),
    (0.38, 0.48, 0.78),
    (0.98, -0.46, 0.39),
)
"""Eight places a neurosurgeon could choose: frontal, parietal and at the vertex, on both sides.

No two distances between the first five differ by less than 4 mm, between all eight by less than 0.6 mm.
"""


def demo_head() -> Scene:
    """Return the scene of ``data/synthetic_ct``: six 11.5 mm markers on posts and five decoys, on a head."""
    markers = [marker(label, scalp_foot(at)) for label, at in DEMO_MARKERS.items()]
    decoys = [decoy(kind, scalp_foot(at)) for kind, at in DEMO_DECOYS.items()]
    return join([head(), *markers, *decoys], "demo head")


def patient(count: int, kind: str = "post") -> Scene:
    """Return the paper's patient set-up: ``count`` (3 to 8) freely placed markers, and what lies about."""
    markers = [marker(f"M{n}", scalp_foot(at), kind) for n, at in enumerate(PATIENT_MARKERS[:count], start=1)]
    everyday = [dental_metal((1, 9)), infusion_tube(), electrode(scalp_foot((-0.95, 0.1, 0.1)))]
    return join([surroundings(), head(), *everyday, *markers], f"patient with {count} {kind} markers")


def patient_with_frame() -> Scene:
    """Return a patient with the bone-implanted x-shaped frame and three adhesive markers."""
    adhesive = [
        marker(f"A{n}", scalp_foot(PATIENT_MARKERS[at]), "ceramic") for n, at in enumerate((2, 3, 6), start=1)
    ]
    frame = x_frame(scalp_foot((0.12, -0.45, 0.88)))
    return join([surroundings(), head(), dental_metal((3,)), *adhesive, frame], "patient with x-frame")


def laboratory_phantom(*, frame: bool = False) -> Scene:
    """Return the laboratory phantom: a hollow plastic head with six markers on plastic screws, or the frame."""
    scalp = np.asarray(SCALP_SEMI_AXES_MM)
    body = Scene(
        (
            Part(box((0, 0, -112), (240, 240, 15)), "polyoxymethylene", "base plate"),
            Part(cylinder((0, 0, -104.5), (0, 0, 1), 60, 90), "plastic", "neck", embedded=True),
            Part(ellipsoid((0, 0, 0), scalp), "plastic", "shell", embedded=True),
            Part(ellipsoid((0, 0, 0), scalp - 8), "air", "hollow", embedded=True),
        )
    )
    if frame:
        markers = [x_frame(scalp_foot((0.12, -0.45, 0.88)))]
    else:
        places = enumerate(PATIENT_MARKERS[:6], start=1)
        markers = [marker(f"M{n}", scalp_foot(at), "plastic screw post") for n, at in places]
    return join([body, *markers], "laboratory phantom" + (" with x-frame" if frame else ""))


def bare_head() -> Scene:
    """Return a patient without markers but with everything that could be taken for one."""
    at = dict(zip(DECOYS, [*PATIENT_MARKERS, (-0.60, 0.62, 0.50)], strict=True))
    others = [decoy(kind, scalp_foot(place)) for kind, place in at.items()]
    everyday = [dental_metal((1, 2, 9)), ear_rings(), infusion_tube()]
    return join([surroundings(), head(), *everyday, *others], "head without markers")


def water_disc() -> Scene:
    """Return a 200 mm water cylinder, the image-quality phantom."""
    return Scene((Part(cylinder((0, 0, -60), (0, 0, 1), 120, 200), "water"),), name="water disc")


def _over_the_head(scene: Scene, **options: float) -> Examination:
    tops = [float(m.center_mm[2]) + 15 for m in scene.markers]
    settings = {"start_mm": -40.0, "stop_mm": max([*tops, 100.0]), "field_of_view_mm": 280.0, **options}
    return Examination(scene, axial_stack(**settings))  # type: ignore[arg-type]


def _numbered_patient(count: int) -> Callable[[], Examination]:
    return lambda: _over_the_head(patient(count))


READY: dict[str, tuple[str, Callable[[], Examination]]] = {
    "demo-head": (
        "six 11.5 mm markers on posts and five decoys (data/synthetic_ct)",
        lambda: _over_the_head(demo_head()),
    ),
    "lab-phantom": (
        "hollow plastic head, six markers on posts with plastic screws",
        lambda: _over_the_head(laboratory_phantom()),
    ),
    "lab-frame": (
        "hollow plastic head with the x-shaped frame",
        lambda: _over_the_head(laboratory_phantom(frame=True)),
    ),
    **{
        f"patient-{count}": (
            f"patient with {count} freely placed markers on bone screws",
            _numbered_patient(count),
        )
        for count in range(3, 9)
    },
    "patient-frame": (
        "patient with the x-shaped frame and three adhesive markers",
        lambda: _over_the_head(patient_with_frame()),
    ),
    "patient-insert": (
        "five markers with a metal insert in the sphere",
        lambda: _over_the_head(patient(5, "post with insert")),
    ),
    "patient-ceramic": ("eight 10 mm ceramic balls on the skin", lambda: _over_the_head(patient(8, "ceramic"))),
    "patient-steel": ("six 5 mm steel balls on the skin", lambda: _over_the_head(patient(6, "steel"))),
    "patient-titanium": (
        "six 3 mm titanium balls, 0.6 mm slices",
        lambda: _over_the_head(patient(6, "titanium 3"), spacing_mm=0.6),
    ),
    "bare-head": ("no marker, but every decoy, dental metal and ear-rings", lambda: _over_the_head(bare_head())),
    "random-patient": ("the random patient of seed 0 (see --seed)", lambda: random_patient(0)),
    "water-disc": ("200 mm water cylinder", lambda: Examination(water_disc(), axial_stack(start_mm=0, stop_mm=4))),
}
"""Ready-made examinations by name: what they show, and their maker."""


def ready(name: str) -> Examination:
    """Return the ready-made examination called ``name``; raises `PhantomError` with the known names."""
    if name not in READY:
        raise PhantomError(f"no ready-made scene is called {name!r}; expected one of {', '.join(READY)}")
    return READY[name][1]()
