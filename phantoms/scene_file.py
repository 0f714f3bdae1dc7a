"""Scenes written in TOML. The tables and keys are described in ``docs/phantoms.md``."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from phantoms import anatomy, decoys, markers, solids, worn
from phantoms.errors import PhantomError
from phantoms.examination import Examination
from phantoms.lifelike import lifelike_head
from phantoms.scanner import Scanner
from phantoms.scene import Marker, Part, Scene, join
from phantoms.solids import FloatArray, Solid
from phantoms.stack import SliceStack, axial_stack

Triple = tuple[float, float, float]
Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]

MOST_BYTES = 1 << 18
"""A scene that a person wrote is not larger."""
MOST_DOTS = 600
"""A line of a scene has fewer: a key of so many parts takes time that grows with their square."""
MARGIN_MM = 20.0
"""Scanned above and below the markers when the file does not say from where to where."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Part(_Table):
    material: str
    name: str = ""
    embedded: bool = False

    def solid(self) -> Solid:
        raise NotImplementedError

    def part(self) -> Part:
        return Part(self.solid(), self.material, self.name, self.embedded)


class _Sphere(_Part):
    shape: Literal["sphere"]
    center: Triple
    diameter: Length
    marker: str = ""
    """Label that makes the sphere a marker."""

    def solid(self) -> Solid:
        return solids.sphere(self.center, self.diameter)


class _Ellipsoid(_Part):
    shape: Literal["ellipsoid"]
    center: Triple
    semi_axes: Triple
    direction: Triple = (0.0, 0.0, 1.0)

    def solid(self) -> Solid:
        return solids.ellipsoid(self.center, self.semi_axes, _turned(self.direction))


class _Box(_Part):
    shape: Literal["box"]
    center: Triple
    size: Triple
    direction: Triple = (0.0, 0.0, 1.0)

    def solid(self) -> Solid:
        return solids.box(self.center, self.size, _turned(self.direction))


class _Cylinder(_Part):
    shape: Literal["cylinder"]
    start: Triple
    direction: Triple
    length: Length
    diameter: Length

    def solid(self) -> Solid:
        return solids.cylinder(self.start, self.direction, self.length, self.diameter)


class _Cone(_Part):
    shape: Literal["cone"]
    start: Triple
    direction: Triple
    length: Length
    diameter: Length
    end_diameter: float = 0.0

    def solid(self) -> Solid:
        return solids.cone(self.start, self.direction, self.length, self.diameter, self.end_diameter)


class _HalfSpace(_Part):
    shape: Literal["half-space"]
    point: Triple
    outward: Triple

    def solid(self) -> Solid:
        return solids.half_space(self.point, self.outward)


class _Place(_Table):
    """Where a thing stands: ``direction`` from the head's center to the scalp, or ``place`` and ``outward``."""

    direction: Triple | None = None
    place: Triple | None = None
    outward: Triple | None = None

    def scene(self, size: float) -> Scene:
        """Return the thing, standing on a head of relative ``size``."""
        raise NotImplementedError

    def foot(self, size: float) -> anatomy.Foot:
        if self.direction is not None and self.place is None and self.outward is None:
            return anatomy.scalp_foot(_nonzero(self.direction), size)
        if self.direction is None and self.place is not None and self.outward is not None:
            outward = _nonzero(self.outward)
            return anatomy.Foot(np.array(self.place), outward / np.linalg.norm(outward))
        raise PhantomError("a marker or decoy needs either 'direction', or both 'place' and 'outward'")


class _Marker(_Place):
    label: str
    kind: str = "post"
    oversize: float = 0.0
    out_of_round: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    covering: str = ""
    bubble: bool = False
    seed: Annotated[int, Field(ge=0)] = 0

    def scene(self, size: float) -> Scene:
        condition = markers.Condition(self.oversize, self.out_of_round, self.covering, self.bubble, self.seed)
        return markers.marker(self.label, self.foot(size), self.kind, condition)


class _Frame(_Place):
    prefix: str = "X"

    def scene(self, size: float) -> Scene:
        return markers.x_frame(self.foot(size), self.prefix)


class _Decoy(_Place):
    kind: str
    like: str = "post"

    def scene(self, size: float) -> Scene:
        return decoys.decoy(self.kind, self.foot(size), self.like)


class _Head(_Table):
    size: Annotated[float, Field(ge=0.3, le=1.5)] = 1.0
    surroundings: bool = True
    infusion_tube: bool = False
    ear_rings: bool = False
    dental_metal: tuple[Annotated[int, Field(ge=0, lt=anatomy.TEETH)], ...] = ()
    electrodes: tuple[Triple, ...] = ()
    lifelike: bool = False
    hair: bool = False
    braces: bool = False
    frame: bool = False

    def scenes(self, seed: int) -> list[Scene]:
        generator = np.random.default_rng([seed, 20260104])
        found = [worn.hair(generator, self.size)] if self.hair else []
        found += [anatomy.surroundings(self.size)] if self.surroundings else []
        found += [lifelike_head(generator, self.size) if self.lifelike else anatomy.head(self.size)]
        found += [anatomy.dental_metal(self.dental_metal, size=self.size)]
        found += [worn.braces(self.size)] if self.braces else []
        found += [worn.head_frame(self.size)] if self.frame else []
        found += [anatomy.infusion_tube(self.size)] if self.infusion_tube else []
        found += [anatomy.ear_rings(self.size)] if self.ear_rings else []
        feet = (anatomy.scalp_foot(_nonzero(at), self.size) for at in self.electrodes)
        return found + [anatomy.electrode(foot) for foot in feet]


class _Scan(_Table):
    start: float | None = None
    stop: float | None = None
    spacing: Length = 1.0
    thickness: Length | None = None
    matrix: int = 512
    field_of_view: Length = 250.0
    center: Triple = (0.0, 0.0, 0.0)
    tilt: float = 0.0

    def stack(self, scene: Scene) -> SliceStack:
        heights = [float(marker.center_mm[2]) - self.center[2] for marker in scene.markers]
        if not heights and (self.start is None or self.stop is None):
            raise PhantomError("the scene has no marker to scan around; give 'start' and 'stop' in [scan]")
        return axial_stack(
            start_mm=min(heights) - MARGIN_MM if self.start is None else self.start,
            stop_mm=max(heights) + MARGIN_MM if self.stop is None else self.stop,
            spacing_mm=self.spacing,
            thickness_mm=self.thickness,
            matrix=self.matrix,
            field_of_view_mm=self.field_of_view,
            center_mm=self.center,
            tilt_deg=self.tilt,
        )


class _Scanner(_Table):
    kernel: str = "standard"
    dose: float = 1.0
    kilovolts: float = 120.0
    views: int = 720
    scatter: float = 0.0
    extended_scale: bool = False


class _File(_Table):
    name: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    head: _Head | None = None
    part: tuple[
        Annotated[_Sphere | _Ellipsoid | _Box | _Cylinder | _Cone | _HalfSpace, Field(discriminator="shape")], ...
    ] = ()
    marker: tuple[_Marker, ...] = ()
    frame: tuple[_Frame, ...] = ()
    decoy: tuple[_Decoy, ...] = ()
    scan: _Scan = _Scan()
    scanner: _Scanner = _Scanner()

    def _labelled(self) -> tuple[Marker, ...]:
        spheres = (part for part in self.part if isinstance(part, _Sphere) and part.marker)
        return tuple(Marker(s.marker, np.array(s.center), s.diameter, s.material) for s in spheres)

    def examination(self, name: str) -> Examination:
        size = self.head.size if self.head else 1.0
        scenes = self.head.scenes(self.seed) if self.head else []
        scenes.append(Scene(tuple(part.part() for part in self.part), self._labelled()))
        standing: tuple[_Place, ...] = (*self.frame, *self.decoy, *self.marker)
        scenes += [thing.scene(size) for thing in standing]
        scene = join(scenes, self.name or name).check()
        return Examination(scene, self.scan.stack(scene), Scanner(**self.scanner.model_dump()), self.seed)


def read_scene(path: str | Path) -> Examination:
    """Return the examination described by a TOML file.

    Raises `PhantomError` for a file that cannot be read, a key that is missing, unknown or of the wrong kind, an
    unknown material or kind, and parts that overlap without being nested.
    """
    path = Path(path)
    try:
        # by way of JSON, since pydantic's strict mode takes a list for a tuple only there
        document = json.dumps(_parsed(path), default=str)
    except OSError as error:
        raise PhantomError(f"cannot read {path}: {error.strerror}; expected a scene file") from error
    except ValueError as error:
        raise PhantomError(f"{path} is not TOML: {error}; expected a scene file") from error
    except RecursionError as error:
        raise PhantomError(f"{path} is nested too deeply; expected a scene file") from error
    try:
        return _File.model_validate_json(document, strict=True).examination(path.stem)
    except ValidationError as error:
        raise PhantomError(f"{path}: {_first(error)}") from error
    except PhantomError as error:
        raise PhantomError(f"{path}: {error}") from error


def _parsed(path: Path) -> dict[str, Any]:
    """Return a file's tables; raises PhantomError for one that is too large, ValueError for one that is no TOML."""
    with path.open("rb") as stream:
        content = stream.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise PhantomError(f"{path} is larger than {MOST_BYTES} bytes; expected a scene file")
    if max(line.count(b".") for line in content.split(b"\n")) > MOST_DOTS:
        raise PhantomError(f"{path} has a line of more than {MOST_DOTS} dots; expected a scene file")
    return tomllib.loads(content.decode("utf-8"))


def _first(error: ValidationError) -> str:
    """Return the first fault as ``where: what``."""
    fault: Any = error.errors()[0]
    if fault["type"] == "json_invalid":  # made here: only levels beyond those that pydantic reads are wrong
        return "it is nested too deeply; expected a scene file"
    where = ".".join(str(step) for step in fault["loc"])
    said = "no such key" if fault["type"] == "extra_forbidden" else f"{fault['msg'][0].lower()}{fault['msg'][1:]}"
    return f"{where}: {said}; see docs/phantoms.md for what a scene may hold"


def _nonzero(direction: Sequence[float]) -> FloatArray:
    return solids.frame_along(direction)[:, 2]


def _turned(direction: Triple) -> FloatArray | None:
    return None if direction == (0.0, 0.0, 1.0) else solids.frame_along(direction)
