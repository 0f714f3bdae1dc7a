"""What tells the images of one series apart, so that they are not one stack."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from ronnaplan.ct.slices import SliceImage
from ronnaplan.ct.values import Vector

ORIENTATION_TOLERANCE: Final = 2e-5
"""Largest difference of direction cosines within one stack: 0.01 mm at 500 mm."""
PIXEL_SPACING_TOLERANCE_MM: Final = 1e-5
"""Largest difference of pixel spacing within one stack: 0.01 mm over 1,000 pixels."""


def _near(one: Vector, other: Vector, tolerance: float) -> bool:
    return one == other or all(abs(a - b) <= tolerance for a, b in zip(one, other, strict=True))


_PLANE: Final[dict[str, Callable[[SliceImage, SliceImage], bool]]] = {
    "orientations": lambda one, other: _near(one.orientation, other.orientation, ORIENTATION_TOLERANCE),
    "sizes": lambda one, other: (one.pixels.rows, one.pixels.columns) == (other.pixels.rows, other.pixels.columns),
    "pixel spacings": lambda one, other: _near(one.spacing_mm, other.spacing_mm, PIXEL_SPACING_TOLERANCE_MM),
    "frames of reference": lambda one, other: (
        one.instance.frame_of_reference_uid == other.instance.frame_of_reference_uid
    ),
    "studies": lambda one, other: one.instance.study_uid == other.instance.study_uid,
    "patients": lambda one, other: one.instance.patient == other.instance.patient,
    "patient positions": lambda one, other: one.instance.patient_position == other.instance.patient_position,
    "stacks": lambda one, other: one.stack_id == other.stack_id,
}
"""What images of one stack share, by what it is called where they do not."""

TUBE_VOLTAGES: Final = "tube voltages"

PASSES: Final[dict[str, Callable[[SliceImage], str]]] = {
    "acquisitions": lambda image: image.acquisition,
    "cardiac phases": lambda image: image.phase,
    "kernels": lambda image: image.kernel,
    "image types": lambda image: "\\".join(image.image_type),
    TUBE_VOLTAGES: lambda image: "" if image.tube_voltage_kv is None else f"{image.tube_voltage_kv:.0f} kV",
    "series numbers": lambda image: image.instance.series_number,
    "descriptions": lambda image: image.instance.description,
}
"""What images of one place are divided by, in this order, by what it is called."""

OF_A_SLICE: Final = frozenset({"cardiac phases", "series numbers", "descriptions"})
"""Those of `PASSES` that a few slices of one scan may have for themselves: described by hand, or of another beat."""


def share_plane(one: SliceImage, other: SliceImage) -> bool:
    """Whether two images may be slices of one stack."""
    return all(is_shared(one, other) for is_shared in _PLANE.values())


def what_differs(images: Sequence[SliceImage]) -> tuple[str, ...]:
    """Name what keeps ``images`` from being slices of one stack; without such, what tells passes apart."""
    first, *others = images
    plane = [name for name, shared in _PLANE.items() if not all(shared(first, other) for other in others)]
    passes = [name for name, key in PASSES.items() if len({key(image) for image in images}) > 1]
    return tuple(plane or passes)


def what_it_has(image: SliceImage, differing: Sequence[str]) -> tuple[str, ...]:
    """Say what ``image`` has of what the parts of its series differ in (`what_differs`), so that one can be chosen.

    What keeps images from being slices of one stack is not told: that is places, or who the patient is.
    """
    told = {name: PASSES[name](image).strip() for name in differing if name in PASSES}
    return tuple(f"{name.removesuffix('s')} {value or 'not told'}" for name, value in told.items())
