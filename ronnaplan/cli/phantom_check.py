"""``ronnaplan phantom-check``: a phantom whose markers' places are known, scanned, tells what a scanner is worth."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ronnaplan.cli.output import tell
from ronnaplan.cli.values import sigma_mm

if TYPE_CHECKING:
    from ronnaplan.documents.phantom_check import CheckedScan
    from ronnaplan.localization import Build
    from ronnaplan.registration.phantom_check import KnownPhantom
    from ronnaplan.registration.phantom_verdict import Estimate

HELP = "Scan a known phantom or template once: how accurate, how honest, and which settings would be better."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("paths", nargs="+", metavar="CT", help="scans of the phantom: folders, files or archives")
    parser.add_argument(
        "--truth",
        required=True,
        metavar="FILE",
        help="the markers' places or distances: template, fiducials.json, or the truth.json of a simulated scan",
    )
    parser.add_argument("--diameter", required=True, metavar="MM", help="diameter of the markers")
    parser.add_argument(
        "--sigma-truth",
        type=sigma_mm,
        metavar="MM",
        help="error of the truth per axis (default: a fiducials.json is as sure as it says, all others are exact)",
    )
    parser.add_argument(
        "--marker", default="solid", metavar="BUILD", help="solid (default), shell:WALL or wrapped:THICKNESS (mm)"
    )
    parser.add_argument("--series", metavar="UID", help="the series to use, where a CT holds several")
    parser.add_argument("-o", "--output", metavar="FILE", help="phantom-check.json (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Check every scan; one that does not pass, or does not pair with the phantom, makes the status 3."""
    from ronnaplan.documents.files import check_target, write_result
    from ronnaplan.documents.phantom_check import phantom_check_document, read_known_phantom
    from ronnaplan.documents.reading import to_json
    from ronnaplan.errors import RefusedError, RonnaplanError, UsageError
    from ronnaplan.localization import Build
    from ronnaplan.localization.localizer import check_request
    from ronnaplan.text import plain_number

    diameter = plain_number(arguments.diameter)
    if diameter is None:
        raise UsageError(f"--diameter is '{arguments.diameter}'; a positive number of mm is needed")
    build = Build.parse(arguments.marker)
    check_request(diameter, None, build)
    phantom = read_known_phantom(arguments.truth, arguments.sigma_truth)
    if arguments.output is not None:
        check_target(arguments.output)
    scans: list[CheckedScan] = []
    failures: list[RonnaplanError] = []
    for path in arguments.paths:
        try:
            scans.append(_checked(path, arguments.series, diameter, build, phantom))
        except RonnaplanError as error:
            if len(arguments.paths) == 1:
                raise
            failures.append(error)
            tell(f"{path}: {error}")
        else:
            tell(_told(scans[-1]))
    if not scans:
        raise failures[0]
    if len(scans) > 1:
        tell(_told_together(scans))
    write_result(arguments.output, to_json(phantom_check_document(phantom, scans)))
    bad = len(failures) + sum(bool(one.reasons) for one in scans)
    if bad:
        raise RefusedError(f"{bad} of {len(arguments.paths)} scans do not pass; see the reasons")
    return 0


def _checked(
    path: str, series: str | None, diameter_mm: float, build: Build, phantom: KnownPhantom
) -> CheckedScan:
    from ronnaplan.ct import read_ct
    from ronnaplan.documents.phantom_check import CheckedScan
    from ronnaplan.localization import localize
    from ronnaplan.localization.advice import recommended_settings
    from ronnaplan.registration.phantom_check import check_phantom, names_of_scan
    from ronnaplan.registration.phantom_verdict import reasons_against
    from ronnaplan.text import printable

    volume = read_ct(path, series, progress=True)
    found = localize(volume, diameter_mm=diameter_mm, marker=build)
    scan = names_of_scan(volume.voxel_sha256, volume.source.series_instance_uid)
    check = check_phantom(phantom, found.points, volume.grid.axes, scan)
    advice = recommended_settings(volume.grid, found)
    return CheckedScan(printable(path), found, check, reasons_against(check), advice)


def _told(one: CheckedScan) -> str:
    """Say what was found of one scan."""
    import numpy as np

    from ronnaplan.registration.phantom_verdict import normalized_error, share_within
    from ronnaplan.report.tables import resolution_line

    check = one.check
    lengths = 1e3 * np.linalg.norm(check.errors_mm, axis=1)
    count = len(check.registration)
    lines = [
        f"{one.path}: {'does not pass' if one.reasons else 'passes'}",
        f"found: {count} of {count + len(check.missing)} markers, {len(check.strange)} others",
        f"error: mean {lengths.mean():.1f} um, worst {lengths.max():.1f} um; per axis "
        f"{1e3 * check.in_slices_rms_mm:.1f} um within the slices, {1e3 * check.across_rms_mm:.1f} um across",
        f"stated errors: {_honesty(normalized_error([check.judged]), share_within([check.within]))}",
        *(
            f"{STRETCH_NAMES[each.name]}: {100 * each.share:+.4f} % +- {100 * each.standard_error:.4f} %"
            for each in check.stretches
        ),
        *resolution_line(one.found),
        *(f"does not pass: {reason}" for reason in one.reasons),
        *(f"better: {each.setting} {each.advised} ({each.found}): {each.reason}" for each in one.advice),
    ]
    return "\n".join(lines if one.advice else [*lines, "settings: nothing to gain"])


STRETCH_NAMES = {
    "in_plane": "scale within the slices",
    "along": "scale along the table",
    "shear_u": "slices slide along their rows",
    "shear_v": "slices slide along their columns",
}


def _honesty(error: Estimate, within: Estimate) -> str:
    return (
        f"normalized error {error.value:.2f} ({error.low:.2f} to {error.high:.2f}), "
        f"{within.value:.0%} within 95 % ({within.low:.0%} to {within.high:.0%})"
    )


def _told_together(scans: list[CheckedScan]) -> str:
    """Sum up several scans."""
    import numpy as np

    from ronnaplan.registration.phantom_verdict import normalized_error, share_within

    error = normalized_error([one.check.judged for one in scans])
    within = share_within([one.check.within for one in scans])
    best = min(scans, key=lambda one: (bool(one.reasons), float(np.mean(one.check.registration.residuals_mm))))
    return f"together: {len(scans)} scans; stated errors: {_honesty(error, within)}; best: {best.path}"
