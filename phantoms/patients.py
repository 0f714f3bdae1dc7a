"""Random patients from a seed, for benchmarks."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from phantoms.anatomy import (
    TEETH,
    Foot,
    dental_metal,
    ear_rings,
    electrode,
    head,
    infusion_tube,
    scalp_foot,
    surroundings,
)
from phantoms.coverings import COVERINGS
from phantoms.decoys import DECOYS, decoy
from phantoms.errors import PhantomError
from phantoms.examination import Examination
from phantoms.lifelike import lifelike_head
from phantoms.markers import KINDS, Condition, Post, made, marker, marker_kind, touching_pair
from phantoms.protocols import Protocol, draw
from phantoms.scanner import Scanner
from phantoms.scene import Scene, join
from phantoms.solids import FloatArray, Vector
from phantoms.stack import SliceStack, axial_stack
from phantoms.surgery import bone_flap, burr_hole, shunt
from phantoms.worn import braces, eeg_cap, hair, head_frame

CLOSEST_FEET_MM = 30.0
"""Markers and decoys stand at least this far apart on the scalp."""

CLEAR_OF_SURGERY_MM = 24.0
"""Burr holes, flaps and valves have their middle at least this far from markers and decoys."""


def random_patient(
    seed: int,
    *,
    kind: str = "post",
    as_made: bool = False,
    covering: str = "",
    covered: float = 1.0,
    touching: int = 0,
    lifelike: bool = False,
    count: int | None = None,
    decoys: int | None = None,
    dental: bool | None = None,
    furniture: bool = True,
    dose: float = 1.0,
    kernel: str | None = None,
    thickness_mm: float | None = None,
    spacing_mm: float | None = None,
    tilt_deg: float = 0.0,
    uneven: bool = False,
    matrix: int = 512,
    protocol: str | None = None,
) -> Examination:
    """Return a patient drawn from ``seed``; what is None is drawn too.

    Drawn are head size (0.88 to 1.05), how the head lies (up to 8 degrees about each axis), 3 to 8 markers and 2
    to 5 decoys at random places of the scalp outside the headrest, dental metal, kernel, field of view and slice
    thickness (0.5 to 1.25 mm). ``uneven`` varies the gaps between slices by a tenth. A ``protocol`` (a key of
    `PROTOCOLS`) decides how the patient is scanned; its own settings are drawn from ``seed``, too.

    ``kind`` may be ``"any"``: one kind for all markers is drawn. ``as_made`` draws each marker's diameter and
    roundness; ``covering`` is what lies on (or, a ``"bubble"``, in) them, all or the share ``covered``, or ``"any"``,
    which draws for each (nothing, a bubble or one of `COVERINGS`); the first ``touching`` markers have a second one at
    their side that touches them.
    ``lifelike`` gives the patient a head of more than ellipsoids, and draws hair, an EEG cap, braces, a head frame,
    burr holes, a bone flap and a shunt.
    """
    plan = None if protocol is None else draw(protocol, seed)
    if plan is not None:
        if (kernel, thickness_mm, spacing_mm) != (None, None, None):
            raise PhantomError("a protocol says kernel, thickness and spacing itself; give a protocol or these")
        thickness_mm, spacing_mm, kernel = plan.thickness_mm, plan.spacing_mm, plan.scanner.kernel
    generator = np.random.default_rng([seed, 20260101])
    scene = _scene(
        generator, seed, kind, as_made, covering, covered, touching, lifelike, count, decoys, dental, furniture
    )
    thickness = float(generator.choice([0.5, 0.6, 0.75, 1.0, 1.25])) if thickness_mm is None else thickness_mm
    chosen = str(generator.choice(["soft", "standard", "bone"], p=[0.25, 0.6, 0.15])) if kernel is None else kernel
    machine = Scanner(kernel=chosen, dose=dose) if plan is None else plan.scanner_at(dose)
    stack = _stack(generator, scene, plan, thickness, spacing_mm or thickness, uneven, matrix, tilt_deg)
    machine = machine.aimed(stack)
    stack = replace(stack, field_radius_mm=machine.field_radius_mm)
    if plan is None:
        return Examination(scene, stack, machine, seed)
    return Examination(scene, stack, machine, seed, plan.finish, plan.name)


def _scene(
    generator: np.random.Generator,
    seed: int,
    kind: str,
    as_made: bool,
    covering: str,
    covered: float,
    touching: int,
    lifelike: bool,
    count: int | None,
    decoys: int | None,
    dental: bool | None,
    furniture: bool,
) -> Scene:
    """Return head, markers, decoys and what is about them, as they lie; what `random_patient` says is drawn.

    Markers and the person have generators of their own: what is asked of either changes nothing else.
    """
    size = generator.uniform(0.88, 1.05)
    count = int(generator.integers(3, 9)) if count is None else count
    decoys = int(generator.integers(2, 6)) if decoys is None else decoys
    feet = [scalp_foot(at, size) for at in _places(generator, count + decoys, size)]
    makes = np.random.default_rng([seed, 20260103])
    kind = str(makes.choice(list(KINDS))) if kind == "any" else kind
    markers = _markers(makes, feet[:count], kind, as_made, covering, covered, touching)
    names = generator.permutation(list(DECOYS))
    others = [decoy(str(names[n % len(names)]), foot, kind) for n, foot in enumerate(feet[count:])]
    post = marker_kind(kind).post
    taller_mm = max(0.0, post.height_mm - Post().height_mm) if post else 0.0
    around = _everyday_things(generator, size, dental, taller_mm) if furniture else Scene()
    base = surroundings(size) if furniture else Scene()
    person = _person(np.random.default_rng([seed, 20260104]), feet, size, base, taller_mm) if lifelike else None
    body = [base, head(size), around] if person is None else [person.before, person.head, around, person.after]
    scene = join([*body, *markers, *others], f"random patient {seed}")
    return scene.moved(_lie(generator), generator.uniform(-12, 12, 3))


def _markers(
    generator: np.random.Generator,
    feet: list[Foot],
    kind: str,
    as_made: bool,
    covering: str,
    covered: float,
    touching: int,
) -> list[Scene]:
    """Draw a marker on each foot, made and covered as `random_patient` says; the first ones touch a second one."""
    return [
        touching_pair((f"M{n + 1}", f"M{len(feet) + n + 1}"), foot, kind, float(generator.uniform(0, 180)))
        if n < touching
        else marker(
            f"M{n + 1}", foot, kind, _condition(generator, as_made, _covering(generator, covering, covered))
        )
        for n, foot in enumerate(feet)
    ]


def _stack(
    generator: np.random.Generator,
    scene: Scene,
    plan: Protocol | None,
    thickness_mm: float,
    spacing_mm: float,
    uneven: bool,
    matrix: int,
    tilt_deg: float,
) -> SliceStack:
    """Draw which slices show the scene, and their field of view; a ``plan`` says how they lie, and in what voxels."""
    turn = np.eye(3) if plan is None else plan.orientation
    positions = _slice_positions(generator, scene.moved(turn.T), spacing_mm, 0.1 if uneven else 0.0)
    field_mm = float(generator.uniform(255, 290))
    if plan is not None and plan.cubic:
        matrix = int(np.ceil(field_mm / thickness_mm))
        field_mm = matrix * thickness_mm
    return axial_stack(
        start_mm=0.0,
        stop_mm=0.0,
        positions_mm=positions,
        thickness_mm=thickness_mm,
        matrix=matrix,
        field_of_view_mm=field_mm,
        center_mm=(*generator.uniform(-6, 6, 2), 0.0),
        tilt_deg=tilt_deg,
        orientation=turn,
    )


class _Person(NamedTuple):
    """What comes before the head (hair, furniture, cap), the head, and what comes after everyday things."""

    before: Scene
    head: Scene
    after: Scene


def _person(
    generator: np.random.Generator, feet: list[Foot], size: float, furniture: Scene, taller_mm: float
) -> _Person:
    """Draw a lifelike head with what it wears and what surgery left in it, clear of what stands on ``feet``."""
    chances = {"hair": 0.6, "frame": 0.25, "cap": 0.25, "braces": 0.3, "hole": 0.4, "flap": 0.25, "shunt": 0.25}
    drawn = {name for name, chance in chances.items() if generator.random() < chance}
    before = hair(generator, size) if "hair" in drawn else Scene()
    before += furniture if "frame" not in drawn else Scene()
    before += eeg_cap(feet, size) if "cap" in drawn and "frame" not in drawn else Scene()
    body = lifelike_head(generator, size)
    for name, make in (("flap", bone_flap), ("hole", burr_hole), ("shunt", partial(shunt, size=size))):
        place = _free_foot(generator, feet, size)
        body += make(place) if name in drawn and place is not None else Scene()
    after = braces(size) if "braces" in drawn else Scene()
    after += head_frame(size, taller_mm) if "frame" in drawn else Scene()
    return _Person(before, body, after)


def _free_foot(generator: np.random.Generator, feet: list[Foot], size: float) -> Foot | None:
    """Draw a place on the upper scalp that is clear of ``feet``; None when there is none."""
    for _ in range(200):
        at = generator.standard_normal(3)
        foot = scalp_foot((at[0], at[1], abs(at[2]) + 0.2), size)
        if min(float(np.linalg.norm(foot.place_mm - other.place_mm)) for other in feet) > CLEAR_OF_SURGERY_MM:
            return foot
    return None


def _places(generator: np.random.Generator, count: int, size: float) -> list[FloatArray]:
    """Draw directions to places on the upper scalp, apart from each other and clear of headrest and ears."""
    chosen: list[FloatArray] = []
    feet_mm: list[FloatArray] = []
    for _ in range(20000):
        if len(chosen) == count:
            return chosen
        at = generator.standard_normal(3)
        at /= np.linalg.norm(at)
        if at[2] < 0.2 or (at[1] > 0.35 and at[2] < 0.72):
            continue
        foot_mm = scalp_foot(at, size).place_mm
        gaps_mm = [np.linalg.norm(foot_mm - other_mm) for other_mm in feet_mm]
        if min(gaps_mm, default=np.inf) >= CLOSEST_FEET_MM:
            chosen.append(at)
            feet_mm.append(foot_mm)
    raise PhantomError(
        f"{count} markers and decoys do not fit on the scalp {CLOSEST_FEET_MM:g} mm apart; ask for fewer"
    )


def _covering(generator: np.random.Generator, name: str, covered: float) -> str:
    """Draw what lies on one marker, or in it."""
    if covered < 1.0 and generator.random() >= covered:
        return ""
    return str(generator.choice(["", "bubble", *COVERINGS])) if name == "any" else name


def _condition(generator: np.random.Generator, as_made: bool, name: str) -> Condition:
    """Draw how one marker is made, with what lies on it or in it."""
    bubble, name = name == "bubble", "" if name == "bubble" else name
    if as_made:
        return made(generator, name, bubble)
    return Condition(covering=name, bubble=bubble, seed=int(generator.integers(2**31)))


def _everyday_things(generator: np.random.Generator, size: float, dental: bool | None, taller_mm: float) -> Scene:
    """Draw dental metal, an infusion tube, ear-rings and electrodes."""
    scene = Scene()
    if generator.random() < 0.7 if dental is None else dental:
        teeth = tuple(int(n) for n in generator.choice(TEETH, int(generator.integers(1, 5)), replace=False))
        scene += dental_metal(teeth, str(generator.choice(["amalgam", "gold"])), size)
    if generator.random() < 0.5:
        scene += infusion_tube(size, taller_mm)
    if generator.random() < 0.3:
        scene += ear_rings(size)
    if generator.random() < 0.4:
        scene += electrode(scalp_foot((-0.95, generator.uniform(-0.3, 0.3), 0.05), size))
    return scene


def _lie(generator: np.random.Generator) -> FloatArray:
    """Draw how the head is turned on the table."""
    turn: FloatArray = Rotation.from_euler("xyz", generator.uniform(-8, 8, 3), degrees=True).as_matrix()
    return turn


def _slice_positions(generator: np.random.Generator, scene: Scene, spacing_mm: float, jitter: float) -> Vector:
    """Return table positions that hold every marker and decoy whole, with a margin of 8 mm."""
    heights = [float(m.center_mm[2]) for m in scene.markers] + [float(d.center_mm[2]) for d in scene.decoys]
    low, high = min([*heights, -20.0]) - 15, max([*heights, 80.0]) + 15
    start = low + generator.uniform(0, spacing_mm)
    gaps = spacing_mm * (1 + generator.uniform(-jitter, jitter, int((high - low) / spacing_mm)))
    positions: FloatArray = np.round(start + np.cumsum(gaps), 3)
    return positions
