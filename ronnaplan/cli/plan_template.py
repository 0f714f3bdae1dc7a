"""``ronnaplan plan template``: a plate for screws whose markers cannot be taken for one another, to be printed."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ronnaplan.cli.case_options import with_sigmas
from ronnaplan.cli.values import number, whole
from ronnaplan.planning.lengths import (
    CLEARANCE_MM,
    HOLE_MM,
    MARKER_HEIGHT_MM,
    PLATE_MM,
    PRINT_TOLERANCE_MM,
    SCREW_PLAY_MM,
    THICKNESS_MM,
    USUAL_DIAMETER_MM,
)

if TYPE_CHECKING:
    from ronnaplan.planning.template_fit import Fitted
    from ronnaplan.planning.template_layout import Bridge, TemplateLayout

HELP = "Design a template for markers that cannot be confused, to be printed."
DRAWINGS = ("svg", "pdf")
LENGTHS = (
    ("thickness", THICKNESS_MM, "thickness of the plate"),
    ("diameter", USUAL_DIAMETER_MM, "diameter of a marker"),
    ("height", MARKER_HEIGHT_MM, "from the plate's upper surface to a marker's center"),
    ("clearance", CLEARANCE_MM, "least distance between two markers' surfaces"),
    ("hole", HOLE_MM, "diameter of a screw's hole"),
    ("print-tolerance", PRINT_TOLERANCE_MM, "a hole may be printed off its place by so much along each axis"),
    (
        "screw-play",
        SCREW_PLAY_MM,
        "a marker may stand off its hole's axis and height by so much: play, tilt and depth of the screw",
    ),
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``plan template``."""
    parser.add_argument("--markers", type=whole(3), required=True, metavar="N", help="3 to 6")
    shape = parser.add_mutually_exclusive_group()
    shape.add_argument("--ct", metavar="PATH", help="bend the plate to this head (default: a standard head)")
    shape.add_argument("--radius", type=number, metavar="MM", help="bend it to this radius")
    shape.add_argument("--flat", action="store_true", help="leave it flat")
    parser.add_argument("--series", metavar="UID", help="the series to use, where the scan's PATH holds several")
    parser.add_argument(
        "--at",
        nargs=3,
        type=number,
        metavar=("X", "Y", "Z"),
        help="a place on the scan's scalp (default: the crown)",
    )
    parser.add_argument("--coordinates", choices=("LPS", "RAS"), help="the system of --at")
    parser.add_argument(
        "--size",
        nargs=2,
        type=number,
        default=PLATE_MM,
        metavar=("WIDTH", "DEPTH"),
        help="of the plate, mm, from side to side and from front to back (default 120 80)",
    )
    for name, default, text in LENGTHS:
        parser.add_argument(
            f"--{name}", type=number, default=default, metavar="MM", help=f"{text} (default %(default)s)"
        )
    with_sigmas(parser)
    parser.add_argument("--seed", type=whole(0), default=0, help="of the search (default 0)")
    parser.add_argument(
        "--name", default="template", help="written on drawing and documents (default %(default)s)"
    )
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FILE",
        help="the body, .stl or .3mf; .json (for localize --template), .svg and .pdf are written beside it",
    )


def run(arguments: argparse.Namespace) -> int:
    """Design the template and write body, document and drawing."""
    from ronnaplan.documents.files import check_target, write_atomically
    from ronnaplan.documents.solids import WRITERS
    from ronnaplan.documents.template import printed_template_document
    from ronnaplan.errors import UsageError
    from ronnaplan.planning.template_drawing import drawing_file, template_drawing
    from ronnaplan.planning.template_layout import design_template
    from ronnaplan.planning.template_solid import template_solid

    body = Path(arguments.output)
    if body.suffix.lower() not in WRITERS:
        raise UsageError(f"-o is '{body}'; expected a name that ends in {' or '.join(WRITERS)}")
    for ending in (body.suffix, ".json", *(f".{kind}" for kind in DRAWINGS)):
        check_target(body.with_suffix(ending))
    _require_none_lost(body.with_suffix(".json"))
    bridge, fitted = _shape(arguments)
    found = design_template(
        arguments.markers,
        bridge,
        sigma_ct_mm=arguments.sigma_ct,
        sigma_ots_mm=arguments.sigma_ots,
        seed=arguments.seed,
    )
    document = printed_template_document(found, arguments.name)
    drawing = template_drawing(found, f"{arguments.name}: {arguments.markers} markers")
    write_atomically(body, WRITERS[body.suffix.lower()](template_solid(found), arguments.name))
    write_atomically(body.with_suffix(".json"), document)
    for kind in DRAWINGS:
        write_atomically(body.with_suffix(f".{kind}"), drawing_file(drawing, kind))
    print(_summary(found, fitted))
    return 0


def _require_none_lost(document: Path) -> None:
    """Raise `InputError` where something else than an earlier template lies in the place of its document."""
    from ronnaplan.documents.template import read_template
    from ronnaplan.errors import InputError

    if document.exists():
        try:
            read_template(document)
        except InputError as error:
            raise InputError(f"{document} is no template, and would be lost; name the body otherwise") from error


def _shape(arguments: argparse.Namespace) -> tuple[Bridge, Fitted | None]:
    """Return the plate and, where it is bent to a scan, how it lies there."""
    from ronnaplan.documents.plan_exchange import to_lps
    from ronnaplan.errors import UsageError
    from ronnaplan.planning.template_layout import STANDARD_RADIUS_MM, Bridge

    if (arguments.at is None) != (arguments.coordinates is None) or (arguments.at and not arguments.ct):
        raise UsageError("--at is a place of the scan; it needs --ct and --coordinates LPS or RAS")
    if arguments.series and not arguments.ct:
        raise UsageError("--series is one of the scan; it needs --ct")
    radius_mm = STANDARD_RADIUS_MM if arguments.radius is None else arguments.radius
    bridge = Bridge(
        size_mm=tuple(arguments.size),
        radius_mm=None if arguments.flat or arguments.ct else radius_mm,  # a scan's own is found below
        thickness_mm=arguments.thickness,
        marker_diameter_mm=arguments.diameter,
        marker_height_mm=arguments.height,
        clearance_mm=arguments.clearance,
        hole_diameter_mm=arguments.hole,
        print_tolerance_mm=arguments.print_tolerance,
        screw_play_mm=arguments.screw_play,
    )
    bridge.check()
    if arguments.ct is None:
        return bridge, None
    import numpy as np

    from ronnaplan.ct import read_ct
    from ronnaplan.planning import Head
    from ronnaplan.planning.sites import scalp_sites
    from ronnaplan.planning.template_fit import bent_to_scalp

    sites = scalp_sites(Head.of(read_ct(arguments.ct, arguments.series, progress=True)))
    at = None if arguments.at is None else to_lps(np.array(arguments.at), arguments.coordinates)
    fitted = bent_to_scalp(bridge, sites, at)
    return fitted.bridge, fitted


def _summary(found: TemplateLayout, fitted: Fitted | None) -> str:
    from ronnaplan.correspondence.told import LEAST_PAIRS
    from ronnaplan.planning.template_layout import refusal_text

    lines = [
        f"nearest rival {found.rival_distance_mm:.1f} mm away, refused for it in "
        f"{refusal_text(found.refusal_probability)} (sigma {found.sigma_ct_mm:g} mm in CT, "
        f"{found.sigma_ots_mm:g} mm at the tracker, {found.bridge.sigma_mm:.2f} mm of print and screws)",
        f"distances in a scan are believed within {found.bridge.distance_tolerance_mm:.2f} mm; any other order of the "
        f"markers is {found.distance_gap_mm:.1f} mm off",
    ]
    if found.bridge.radius_mm is None and len(found.holes_mm) > LEAST_PAIRS:
        lines.append(
            "four and more flat markers nearly are their own mirror image: up to 0.2 % of their readings are refused "
            "as left-handed, of those of a bent plate hardly any"
        )
    if fitted is not None:
        from ronnaplan.planning.template_fit import ROOM_MM

        x, y, z = fitted.lps_from_template[:3, 3]
        lines.append(
            f"bent to a radius of {fitted.bridge.radius_mm:.0f} mm about ({x:.1f}, {y:.1f}, {z:.1f}) mm LPS; "
            f"{ROOM_MM:g} to {fitted.widest_gap_mm:.1f} mm over the scalp"
        )
    return "\n".join(lines)
