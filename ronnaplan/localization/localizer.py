"""From a scan to its markers: detect, fit, accept. `localize` is the pipeline's own description.

1. Copies of the nearest voxels (`repeated`) and slices that were computed from others (`measured`) are left out; those
   that cubic splines computed tell the measured ones again (`splined`). Grey values are brought to HU (`hounsfield`),
   and a tag that says far too much of the slices' thickness is left out, too (`thick`).
2. Each candidate is detected, fitted and judged by itself (`examine`). What a head (`hardened`), a screw (`crossed`)
   and a socket's rim (`rim`) do to its image is made good.
   All of that is done again where slices are far thicker than the header says (`thick`), where rays were summed before
   the logarithm was taken (`logarithm`), or where slices blur aslant (`slant`).
3. What was turned down only for what is usual in the scan is judged again (`usual`), and metal that was cut off
   before the scan was resampled is fitted anew (`cut_before`).
4. What is unlike the scan's other markers is turned down (`usual`, too).
5. Each marker's covariance counts what is usual in the scan (`together`), and motion is suspected (`moving`).
6. Markers are numbered from the top; another number than expected is refused. Markers that are alike ellipsoids tell
   that the scan's geometry may be wrong; where few are found, or all are of another size, candidates (`stretched`).

Where balls may be is told in `search`, how one is fitted in `fit`, what slices and rays do to it in `scanner`, whether
it is a marker and how sure its center is in `judge`, what the balls of a scan say together in `scanwide`.
`docs/localization.md` tells what each step rests on.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from numbers import Integral, Real

import numpy as np

from ronnaplan.ct.progress import Progress
from ronnaplan.ct.volume import WAYS_TO_A_VOLUME, CTVolume
from ronnaplan.errors import InputError, RefusedError, UsageError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.examine import Examined, examine, examine_places, markers_in, same_places
from ronnaplan.localization.fiducials import Fiducial, FiducialFlag, Fiducials, Rejected
from ronnaplan.localization.judge.uncertainty import NEIGHBOUR_COVERAGE
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanner.summed import UNTOLD
from ronnaplan.localization.scanwide.cut_before import as_cut_before
from ronnaplan.localization.scanwide.logarithm import as_summed
from ronnaplan.localization.scanwide.moving import moved
from ronnaplan.localization.scanwide.slant import along_the_blur
from ronnaplan.localization.scanwide.stretched import distortion
from ronnaplan.localization.scanwide.thick import as_thick, as_thin
from ronnaplan.localization.scanwide.together import with_doubted_sizes, with_usual_errors
from ronnaplan.localization.scanwide.usual import by_the_usual, unlike_turned_down, usual_profiles_mm
from ronnaplan.localization.size import proposal, sizes_seen
from ronnaplan.localization.template import Template, distance_error_mm, match_template
from ronnaplan.text import place, sizes

LOG = logging.getLogger(__name__)

MIN_VOXELS_PER_DIAMETER = 2.0
"""A ball smaller than this many pixels has no shape to recognize it by."""

TOUCHING_SLICES = 1.25
"""Slices farther apart than this many widths of their profile leave gaps between them."""

NEAREST_SHOWN = 3
"""A refusal names this many of the candidates that came nearest to acceptance."""


def localize(
    volume: CTVolume,
    *,
    diameter_mm: float | Sequence[float] | FloatArray,
    expected: int | None = None,
    template: Template | None = None,
    marker: Build = SOLID,
    progress: Progress = False,
) -> Fiducials:
    """Find every ball of ``diameter_mm`` in a scan, its center (LPS mm) and the center's covariance (mm^2).

    Several diameters may be given for several kinds of marker. With a ``template`` only the markers that stand
    at its distances are kept, under its labels. ``marker`` says whether the balls are hollow or wrapped.
    With ``progress`` a long search shows a bar on standard error, or tells how far it is. Raises `UsageError` for a
    diameter that is not a positive number, `InputError` for one below `MIN_VOXELS_PER_DIAMETER` pixels, and
    `RefusedError` when ``expected`` markers were promised and another number was found, or when the template is not
    found exactly once.
    """
    check_type(volume, CTVolume, "the volume", WAYS_TO_A_VOLUME)
    check_type(template, (Template, type(None)), "the template", "documents.read_template returns one")
    check_type(marker, Build, "the marker", "Build.parse('shell:1') returns one")
    diameters = check_request(diameter_mm, expected, marker)
    with ThreadPoolExecutor(1) as beside:
        # To say which scan it is takes half as long as to find its markers.
        beside.submit(lambda: volume.voxel_sha256)
        scan, examined = _examined(volume, diameters, marker, progress)
    scan, examined, markers = _told_together(scan, examined, marker)
    fiducials, rejected = _numbered(scan, markers), _rejected(examined, markers)
    distorted = distortion(scan, examined, markers, partial(examine_places, build=marker))
    departure_mm = None
    if template is not None:
        fiducials, others, departure_mm = _by_template(template, fiducials, distorted)
        rejected = (*others, *rejected)
    result = Fiducials(
        tuple(fiducials),
        rejected,
        diameters,
        volume.source,
        volume.voxel_sha256,
        volume_flags=scan.flags,
        marker=marker,
        stated_thickness_mm=volume.grid.thickness_mm,
        distance_error_mm=departure_mm,
        profile_axis=scan.profile_axis,
        summed_first=None if scan.summed == UNTOLD else scan.summed.first,
        distortion=distorted,
    )
    _tell(result)
    require_count(result, expected, volume, progress)
    return result


def _examined(
    volume: CTVolume, diameters: Sequence[float], marker: Build, progress: Progress
) -> tuple[Scan, list[Examined]]:
    """Return what was measured of a scan, and its candidates, fitted and judged one by one.

    What their balls together say of the scan is made good: slices far thicker than the header says, rays that were
    summed before the logarithm was taken, or slices that blur in another direction than their normal, which summed rays
    can feign. Where they still do, nothing is made good of summing: what was summed did not lie as they do.
    """
    scan = as_thin(Scan.of(volume))
    for diameter in diameters:
        _check_size(scan, diameter)
    examined = examine(scan, diameters, marker, progress)
    thick = as_thick(scan, examined, partial(examine_places, build=marker, progress=progress))
    if thick is not scan:
        scan, examined = thick, examine(thick, diameters, marker, progress)
    scan = as_summed(scan, examined, marker)
    if scan.summed.first:
        wanted = [(one.candidate_mm, one.stated_mm) for one in examined]
        examined = examine_places(scan, wanted, marker, progress)
    turned = along_the_blur(scan, examined, marker)
    return (scan, examined) if turned is scan else (turned, examine(turned, diameters, marker, progress))


def _told_together(
    scan: Scan, examined: Sequence[Examined], marker: Build
) -> tuple[Scan, list[Examined], list[Examined]]:
    """Return the scan, its candidates, and its markers from the top of the head down, as all of them together tell."""
    (examined,) = by_the_usual([(scan, examined)], marker)
    scan, examined = as_cut_before(scan, examined, partial(examine_places, build=marker))
    judged = unlike_turned_down(markers_in(examined))
    turned_down = [one for one in examined if not one.is_marker]
    accepted = [one for one in judged if one.is_marker]
    stated = with_usual_errors(scan, with_doubted_sizes(accepted, turned_down))
    return scan, [*turned_down, *judged], sorted(stated, key=lambda one: tuple(-one.center_mm[::-1]))


def _by_template(
    template: Template, fiducials: list[Fiducial], distorted: str | None
) -> tuple[list[Fiducial], tuple[Rejected, ...], float]:
    """Return the template's markers, the others, and by how much distances depart (mm).

    A refusal says how the scan may be ``distorted``, too.
    """
    try:
        kept, others = match_template(template, fiducials)
    except RefusedError as error:
        if distorted is None:
            raise
        raise RefusedError(f"{error}; {distorted}") from error
    return kept, others, distance_error_mm(template, kept)


def _tell(found: Fiducials) -> None:
    LOG.info("found %r", found)
    for one in found:
        LOG.debug("%s at %s mm, error %.4f mm RMS %s", one.label, one.center_mm, one.error_rms_mm, list(one.flags))
    for other in found.rejected:
        LOG.debug("no marker at %s mm: %s", other.center_mm, other.reason)


def require_count(
    found: Fiducials, expected: int | None, volume: CTVolume | None = None, progress: Progress = False
) -> None:
    """Raise `RefusedError` where ``expected`` markers were promised and another number was found.

    Where there are none, the sizes seen in the ``volume`` are told, if it is given.
    """
    if expected is None or len(found) == expected:
        return
    told = _explain_count(found, expected)
    if found.distortion is not None:
        told += f"; {found.distortion}"
    elif volume is not None and not len(found):
        told += f"; {proposal(sizes_seen(volume, found.marker, progress=bool(progress)))}"
    raise RefusedError(told)


def check_request(
    diameter_mm: float | Sequence[float] | FloatArray, expected: int | None, marker: Build
) -> tuple[float, ...]:
    """Return the diameters as a tuple; raise `UsageError` for diameters, walls or a number that no scan can have."""
    several = isinstance(diameter_mm, Sequence | np.ndarray) and not isinstance(diameter_mm, str)
    given: list[object] = np.ravel(np.asarray(diameter_mm, object)).tolist() if several else [diameter_mm]
    numbers = [float(one) for one in given if isinstance(one, Real) and not isinstance(one, bool)]
    if len(numbers) < len(given):
        how = ", which common_diameter(volume) finds" if given == ["auto"] else ""
        raise UsageError(f"the marker diameter is {diameter_mm!r}; a positive number of mm is needed{how}")
    diameters = tuple(dict.fromkeys(numbers))
    if not diameters:
        raise UsageError("no marker diameter was given; at least one positive number of mm is needed")
    for diameter in diameters:
        if not (math.isfinite(diameter) and diameter > 0):
            raise UsageError(f"the marker diameter is {diameter}; a positive number of mm is needed")
        marker.require_hollow(diameter)
    if expected is not None and (isinstance(expected, bool) or not isinstance(expected, Integral) or expected < 0):
        raise UsageError(f"{expected!r} markers were expected; a whole number from 0 upwards is needed")
    return diameters


def _check_size(scan: Scan, diameter_mm: float) -> None:
    volume = scan.volume
    extent_mm = max(
        np.array(volume.voxels_hu.shape[1:]) * [volume.grid.row_spacing_mm, volume.grid.column_spacing_mm]
    )
    if diameter_mm > extent_mm / 2:
        raise InputError(
            f"a marker of {diameter_mm:g} mm fills more than half of this scan's {extent_mm:.0f} mm; "
            "check the diameter"
        )
    if diameter_mm < MIN_VOXELS_PER_DIAMETER * volume.grid.pixel_mm:
        raise InputError(
            f"a marker of {diameter_mm:g} mm is smaller than {MIN_VOXELS_PER_DIAMETER:g} pixels of this scan "
            f"({volume.grid.pixel_mm:.3f} mm each); scan with a smaller field of view"
        )


def _numbered(scan: Scan, markers: Sequence[Examined]) -> list[Fiducial]:
    """Number the markers in their order, with what all of them together say of each one's profile and motion."""
    told = zip(markers, usual_profiles_mm(markers), moved(scan, markers), strict=True)
    return [
        _fiducial(f"F{number}", one, scan, profile_mm, has_moved=has_moved)
        for number, (one, profile_mm, has_moved) in enumerate(told, start=1)
    ]


def _rejected(examined: Iterable[Examined], markers: Sequence[Examined]) -> tuple[Rejected, ...]:
    """The candidates that failed, fewest tests first; those that turned out to be markers are left out."""
    turned_down = [one for one in examined if not one.is_marker]
    at_none = ~same_places(turned_down, markers).any(axis=1)
    failed = [turned_down[n] for n in np.flatnonzero(at_none)]
    return tuple(
        Rejected(one.candidate_mm, *one.failures[0], one.parameters, one.center_mm)
        for one in sorted(failed, key=lambda one: (len(one.failures), one.misfit))
    )


def _fiducial(label: str, one: Examined, scan: Scan, profile_mm: float, *, has_moved: bool) -> Fiducial:
    """Return a marker with the reasons to doubt it; ``profile_mm`` is the slice profile's width, as the scan shows it.

    Slices that the header says touch do not leave gaps: few markers, or such as are clipped, tell a profile badly.
    """
    seen_mm = max(profile_mm, scan.volume.grid.thickness_mm or 0.0)
    gap_mm = scan.gap_across_mm(one.center_mm, one.diameter_mm / 2.0)
    flags = {
        FiducialFlag.CUT: one.unseen > 0,
        FiducialFlag.NEIGHBOUR: one.coverage < NEIGHBOUR_COVERAGE,
        FiducialFlag.CLIPPED: one.is_clipped,
        FiducialFlag.DIAMETER: one.is_off_size,
        FiducialFlag.COVERED: one.is_covered,
        FiducialFlag.MOTION_SUSPECTED: has_moved,
        FiducialFlag.THICK_SLICES: profile_mm > one.stated_mm / 2.0,
        FiducialFlag.GAPPED: gap_mm > TOUCHING_SLICES * seen_mm,
    }
    return Fiducial(
        label=label,
        center_mm=one.center_mm,
        covariance_mm2=one.covariance_mm2,
        bound_mm2=one.bound_mm2,
        parameters=one.parameters,
        coverage=one.coverage,
        misfit=one.misfit,
        flags=tuple(flag for flag, raised in flags.items() if raised),
    )


def _explain_count(result: Fiducials, expected: int) -> str:
    were = "marker of {} mm was" if len(result) == 1 else "markers of {} mm were"
    found = f"{len(result)} {were.format(sizes(result.diameters_mm))} found, {expected} expected"
    if len(result) > expected or not result.rejected:
        return f"{found}; check the diameter and the number"
    near = ", ".join(f"{place(one.center_mm)}: {one.reason}" for one in result.rejected[:NEAREST_SHOWN])
    return f"{found}; nearest to acceptance were {near}"
