"""A frame of markers at known distances: finds it among the markers of a scan, labels it, checks it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ronnaplan.errors import InputError, RefusedError, check_type
from ronnaplan.geometry import MIRROR, FloatArray, as_numbers, as_points, mutual_distances
from ronnaplan.localization.fiducials import Fiducial, Rejected
from ronnaplan.rigid import fit_closed_form, fre_rms_mm

DISTANCE_TOLERANCE_MM = 0.5
"""Distances in CT and on the drawing agree within this, unless the template says otherwise. (Šuligoj et al. 2018
measured 0.11 +- 0.10 mm on their phantom.)"""

EXACT_MM = 1e-6
"""By no more than this the two distances of the same markers differ, as when they were computed."""


@dataclass(frozen=True, repr=False)
class Template:
    """``distances_mm`` (N, N) between the markers called ``labels``, right within ``tolerance_mm``.

    Distances do not tell a frame from its mirror image, but ``centers_mm`` (N, 3), in any right-handed frame, do. A
    frame whose mirror image has the same distances in another order is refused as ambiguous, like any other that fits
    in two ways. Raises `InputError` for distances that are none between so many markers, and for other numbers of
    labels and centers.
    """

    name: str
    labels: tuple[str, ...]
    distances_mm: FloatArray
    tolerance_mm: float = DISTANCE_TOLERANCE_MM
    centers_mm: FloatArray | None = None

    def __post_init__(self) -> None:
        check_type(self.labels, (tuple, list), "the labels of a template", "give a name for each marker")
        count, whose = len(self.labels), f"the distances of template '{self.name}'"
        object.__setattr__(self, "labels", tuple(self.labels))
        if self.centers_mm is not None:
            centers_mm = as_points(self.centers_mm, f"the centers of template '{self.name}'")
            object.__setattr__(self, "centers_mm", centers_mm)
            if len(centers_mm) != count:
                raise InputError(
                    f"template '{self.name}' has {len(centers_mm)} centers for {count} labels; give one for each"
                )
        expected = f"({count}, {count}) in mm, between the markers of its {count} labels"
        distances_mm = as_numbers(self.distances_mm, whose, expected)
        object.__setattr__(self, "distances_mm", distances_mm)
        if distances_mm.shape != (count, count):
            raise InputError(f"{whose} have shape {distances_mm.shape}; expected {expected}")
        if not np.allclose(distances_mm, distances_mm.T, rtol=0.0, atol=EXACT_MM) or np.diag(distances_mm).any():
            raise InputError(f"{whose} are not finite and symmetric with a zero diagonal; expected {expected}")

    def __repr__(self) -> str:
        return f"Template({self.name}: {', '.join(self.labels)}, distances right within {self.tolerance_mm:g} mm)"


def match_template(
    template: Template, fiducials: Sequence[Fiducial]
) -> tuple[list[Fiducial], tuple[Rejected, ...]]:
    """Return the markers of ``template``, in its order and under its labels, and all others as rejected.

    Raises `RefusedError` when no choice of markers has the template's distances, or more than one has, or the one is
    its mirror image.
    """
    centers = np.array([one.center_mm for one in fiducials], dtype=np.float64).reshape(-1, 3)
    matches = list(_assignments(template, mutual_distances(centers), ()))
    if len(matches) != 1:
        count = "none" if not matches else f"{len(matches)} choices"
        raise RefusedError(
            f"of {len(fiducials)} markers {count} have the distances of template '{template.name}' within "
            f"{template.tolerance_mm:g} mm, exactly one choice is needed; check the template and the scan"
        )
    (chosen,) = matches
    _require_hand(template, centers[list(chosen)])
    labelled = [replace(fiducials[n], label=label) for n, label in zip(chosen, template.labels, strict=True)]
    others = tuple(
        Rejected(
            one.center_mm,
            "template",
            f"it is no marker of template '{template.name}'",
            one.parameters,
            one.center_mm,
        )
        for n, one in enumerate(fiducials)
        if n not in chosen
    )
    return labelled, others


def distance_error_mm(template: Template, fiducials: Sequence[Fiducial]) -> float:
    """Return by how much the distances of a template's markers, in its order, depart from its own at most."""
    distances = mutual_distances(np.array([one.center_mm for one in fiducials]))
    return float(np.max(np.abs(distances - template.distances_mm)))


def _require_hand(template: Template, found_mm: FloatArray) -> None:
    """Raise `RefusedError` where the markers found (N, 3) are the mirror image of the template's places, if known."""
    if template.centers_mm is None:
        return
    as_stated, mirrored = (
        float(fre_rms_mm(fit_closed_form(places_mm, found_mm), places_mm, found_mm))
        for places_mm in (template.centers_mm, template.centers_mm * MIRROR)
    )
    if as_stated > max(template.tolerance_mm, 2.0 * mirrored):
        raise RefusedError(
            f"the markers found are the mirror image of template '{template.name}': it misses them by "
            f"{as_stated:.2f} mm RMS, its mirror image by {mirrored:.2f} mm; one of the two is left-handed, check which"
        )


def _assignments(template: Template, distances: FloatArray, chosen: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Every way to give the template's markers, in order, to points at matching ``distances`` (M, M)."""
    row = len(chosen)
    if row == len(template.labels):
        yield chosen
        return
    for point in range(len(distances)):
        if point in chosen:
            continue
        errors = distances[point, list(chosen)] - template.distances_mm[row, :row]
        if np.all(np.abs(errors) <= template.tolerance_mm):
            yield from _assignments(template, distances, (*chosen, point))
