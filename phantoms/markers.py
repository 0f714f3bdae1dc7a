"""Markers of every kind. LPS mm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from phantoms.anatomy import Foot
from phantoms.coverings import COATING_MM, Covered, bubble, covering
from phantoms.errors import PhantomError
from phantoms.scene import Marker, Part, Scene
from phantoms.solids import FloatArray, box, cone, cylinder, ellipsoid, frame_along, sphere

SKIN_GAP_MM = 0.1
"""Height of the lowest point of a ball that is glued to the skin."""
DIAMETER_TOLERANCE_MM = 0.2
OUT_OF_ROUND = 0.02
"""How far markers as they are made may be off: in diameter, and longest over shortest diameter minus one."""
TOUCHING_GAP_MM = 1e-6
"""Left between two markers that touch, so that rounding does not make them overlap."""
FRAME_ARMS = ((24.0, 33.0), (136.0, 58.0), (205.0, 58.0), (329.0, 57.0))
"""Angle (degrees) and length (mm) of the x-shaped frame's arms; the six distances differ by more than 10 mm."""


@dataclass(frozen=True)
class Post:
    """What carries a sphere: a bone screw with its head, a base on the scalp, and a neck into the sphere."""

    height_mm: float = 8.0
    """Distance from the scalp to the lowest point of the sphere."""
    base_mm: tuple[float, float] = (10.0, 4.0)
    """Diameter and height."""
    neck_mm: tuple[float, float] = (4.0, 1.5)
    """Diameter, and depth in the sphere."""
    neck: str = ""
    """Material of the neck; the sphere's when empty."""
    screw: str = "titanium"
    screw_mm: tuple[float, float] = (2.0, 8.0)
    """Diameter, and depth below the scalp, the tip not counted."""
    head_mm: tuple[float, float] = (4.0, 3.0)
    """Diameter of the screw's head, and its height over the scalp."""


@dataclass(frozen=True)
class Insert:
    """A threaded metal sleeve in the lower part of a sphere, from half a millimetre above its lowest point."""

    material: str = "titanium"
    diameter_mm: float = 3.0
    length_mm: float = 5.0


@dataclass(frozen=True)
class MarkerKind:
    """A sphere on a post or, without ``post``, one that touches the skin."""

    diameter_mm: float
    material: str
    post: Post | None = None
    insert: Insert | None = None
    wall_mm: float = 0.0
    """Thickness of a hollow sphere's shell; 0 is a solid ball."""
    coated: bool = False
    """Whether the outermost `COATING_MM` of the diameter are retro-reflective glass beads."""


@dataclass(frozen=True)
class Condition:
    """How one marker departs from what its kind promises, and what lies on it."""

    oversize_mm: float = 0.0
    """True minus stated diameter."""
    out_of_round: float = 0.0
    """Longest over shortest diameter minus one."""
    covering: str = ""
    """A key of `COVERINGS`; empty when nothing lies on the marker."""
    bubble: bool = False
    seed: int = 0
    """Draws the direction of what is not round and of what covers."""


AS_STATED = Condition()
METAL_POST, METAL_THREAD = Post(neck="titanium", neck_mm=(3.0, 1.0)), Insert("titanium", 3.0, 3.5)
KINDS = {
    "post": MarkerKind(11.5, "acrylic", Post()),
    "post with insert": MarkerKind(11.5, "acrylic", Post(), Insert()),
    "plastic screw post": MarkerKind(11.5, "acrylic", Post(screw="nylon")),
    "short post": MarkerKind(
        11.5, "acrylic", Post(5.0, (8.0, 2.0), screw_mm=(1.5, 5.0), head_mm=(3.0, 1.5)), Insert("steel", 2.0, 4.0)
    ),
    "tall post": MarkerKind(
        11.5, "PEEK", Post(15.0, (12.0, 5.0), (5.0, 2.0), screw_mm=(2.7, 10.0), head_mm=(5.0, 4.0))
    ),
    "metal post": MarkerKind(11.5, "polyoxymethylene", METAL_POST, METAL_THREAD),
    "steel insert post": MarkerKind(11.5, "acrylic", Post(screw="steel"), Insert("steel", 4.0, 6.0)),
    "coated post": MarkerKind(11.5, "acrylic", Post(), coated=True),
    "hollow plastic post": MarkerKind(11.5, "acrylic", Post(), wall_mm=1.0),
    "hollow glass post": MarkerKind(11.5, "glass", Post(neck="acrylic"), wall_mm=0.8),
    "hollow metal post": MarkerKind(11.5, "polyoxymethylene", METAL_POST, METAL_THREAD, wall_mm=1.5, coated=True),
    "ceramic": MarkerKind(10.0, "ceramic"),
    "hollow ceramic": MarkerKind(10.0, "ceramic", wall_mm=1.0),
    "steel": MarkerKind(5.0, "steel"),
    "titanium 3": MarkerKind(3.0, "titanium"),
    "titanium 4": MarkerKind(4.0, "titanium"),
}
"""The marker kinds by name: the retro-reflective sphere on screws of several makes, and balls glued to the skin."""


def marker_kind(name: str) -> MarkerKind:
    """Return the kind called ``name``; raises `PhantomError` with the known names."""
    if name not in KINDS:
        raise PhantomError(f"unknown marker kind {name!r}; expected one of {', '.join(KINDS)}")
    return KINDS[name]


def marker(label: str, foot: Foot, kind: str | MarkerKind = "post", condition: Condition = AS_STATED) -> Scene:
    """Return one marker standing on ``foot``; its truth is what it is, not what its kind promises."""
    if isinstance(kind, str):
        kind = marker_kind(kind)
    real = replace(kind, diameter_mm=kind.diameter_mm + condition.oversize_mm)
    over = covering(condition.covering) if condition.covering else None
    lift_mm = over.lift_mm if over and not real.post else 0.0
    center = foot.above(stand_mm(real) + lift_mm + real.diameter_mm / 2)
    generator = np.random.default_rng([condition.seed, 20260102])
    under = Covered(foot, center, real.diameter_mm * (1 + condition.out_of_round / 2), generator)
    parts = over.parts(under) if over else []
    parts += [*post_parts(foot, real), *_ball(label, center, real, condition.out_of_round, generator)]
    if real.insert:
        size = real.insert
        start = stand_mm(real) + 0.5
        parts.append(upright(foot, start, size.length_mm, size.diameter_mm, size.material, "metal insert"))
    if condition.bubble:
        parts.append(bubble(under))
    truth = Marker(
        label,
        center,
        real.diameter_mm,
        real.material,
        stated_diameter_mm=kind.diameter_mm,
        wall_mm=real.wall_mm,
        out_of_round=condition.out_of_round,
        covering=", ".join([condition.covering] * bool(over) + ["bubble"] * condition.bubble),
    )
    return Scene(tuple(parts), (truth,))


def made(generator: np.random.Generator, covering: str = "", bubble: bool = False) -> Condition:
    """Draw a marker as it is made: its diameter to `DIAMETER_TOLERANCE_MM`, up to `OUT_OF_ROUND` out of round."""
    return Condition(
        round(float(generator.uniform(-DIAMETER_TOLERANCE_MM, DIAMETER_TOLERANCE_MM)), 4),
        round(float(generator.uniform(0.0, OUT_OF_ROUND)), 5),
        covering,
        bubble,
        int(generator.integers(2**31)),
    )


def touching_pair(
    labels: tuple[str, str], foot: Foot, kind: str | MarkerKind = "post", turn_deg: float = 0
) -> Scene:
    """Return two markers whose balls touch, side by side on ``foot``; ``turn_deg`` turns them about its normal."""
    known = marker_kind(kind) if isinstance(kind, str) else kind
    frame, turn = frame_along(foot.outward), np.radians(turn_deg)
    aside = (known.diameter_mm + TOUCHING_GAP_MM) / 2 * (np.cos(turn) * frame[:, 0] + np.sin(turn) * frame[:, 1])
    feet = [Foot(foot.place_mm + side * aside, foot.outward) for side in (-1, 1)]
    return marker(labels[0], feet[0], known) + marker(labels[1], feet[1], known)


def _ball(
    label: str, center: FloatArray, kind: MarkerKind, out_of_round: float, generator: np.random.Generator
) -> list[Part]:
    """Return the coat, the ball or shell, and its cavity; what is not round is so in a direction that is drawn."""
    turn = Rotation.random(random_state=generator).as_matrix() if out_of_round else None
    shape = np.array([1 - out_of_round / 2, 1.0, 1 + out_of_round / 2])

    def layer(depth_mm: float, material: str, name: str) -> Part:
        solid = ellipsoid(center, (kind.diameter_mm / 2 - depth_mm) * shape, turn)
        return Part(solid, material, name, embedded=enters_neck(kind))

    coat_mm = COATING_MM if kind.coated else 0.0
    layers = [layer(0.0, "glass beads", f"coat {label}")] if kind.coated else []
    layers.append(layer(coat_mm, kind.material, f"marker {label}"))
    if kind.wall_mm:
        layers.append(layer(coat_mm + kind.wall_mm, "air", f"cavity {label}"))
    return layers


def enters_neck(kind: MarkerKind) -> bool:
    """Whether the post's neck is of another material than what stands on it and replaces its tip."""
    return kind.post is not None and (bool(kind.post.neck) or kind.coated or kind.wall_mm > 0)


def stand_mm(kind: MarkerKind) -> float:
    """Return the distance from the scalp to the lowest point of a marker's ball."""
    return kind.post.height_mm if kind.post else SKIN_GAP_MM


def upright(foot: Foot, start: float, length: float, diameter: float, material: str, name: str) -> Part:
    """Return a cylinder that stands on ``foot`` from the height ``start``."""
    return Part(cylinder(foot.above(start), foot.outward, length, diameter), material, name, embedded=True)


def post_parts(foot: Foot, kind: MarkerKind) -> list[Part]:
    """Return the self-drilling screw, the base and the neck below a sphere; nothing without a post."""
    if not kind.post:
        return []
    post = kind.post
    (thickness, depth), (head, rise), (base, base_height) = post.screw_mm, post.head_mm, post.base_mm
    neck, entry = post.neck_mm
    neck_mm = post.height_mm + entry - base_height
    return [
        Part(cone(foot.above(-depth), -foot.outward, 4, thickness), post.screw, "screw tip", embedded=True),
        upright(foot, 0, base_height, base, kind.material, "base"),
        upright(foot, base_height, neck_mm, neck, post.neck or kind.material, "neck"),
        upright(foot, -depth, depth + 2, thickness, post.screw, "bone screw"),
        upright(foot, -1, rise + 1, head, post.screw, "screw head"),
    ]


def x_frame(foot: Foot, prefix: str = "X") -> Scene:
    """Return the bone-implanted x-shaped frame: four spheres at unique distances, on two bars and one screw."""
    known = marker_kind("post")
    side = np.cross(foot.outward, [0.0, 1.0, 0.2])
    side /= np.linalg.norm(side)
    ahead = np.cross(foot.outward, side)
    parts = [
        upright(foot, -11, 26, 3.0, "titanium", "frame screw"),
        upright(foot, 0, 16, 12.0, "PEEK", "frame column"),
    ]
    markers = []
    for number, (angle_deg, length) in enumerate(FRAME_ARMS, start=1):
        angle = np.radians(angle_deg)
        arm = np.cos(angle) * side + np.sin(angle) * ahead
        turn = np.column_stack([arm, np.cross(foot.outward, arm), foot.outward])
        bar = box(foot.above(18) + arm * (length + 6) / 2, (length + 6, 9, 5), turn)
        center = foot.above(20.5 + 5 + known.diameter_mm / 2) + arm * length
        neck = cylinder(foot.above(20) + arm * length, foot.outward, 7, 4.0)
        label = f"{prefix}{number}"
        parts += [Part(bar, "PEEK", "frame arm", embedded=True), Part(neck, known.material, "neck", embedded=True)]
        parts.append(Part(sphere(center, known.diameter_mm), known.material, f"marker {label}"))
        markers.append(Marker(label, center, known.diameter_mm, known.material, known.diameter_mm))
    return Scene(tuple(parts), tuple(markers))
