"""``ronnaplan phantom``: make a synthetic CT whose markers' true places are known."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from ronnaplan.cli.output import tell
from ronnaplan.cli.values import number, whole

if TYPE_CHECKING:
    from phantoms.examination import Examination
    from phantoms.series import SeriesOptions

HELP = "Scan a synthetic head and write the DICOM series with the true marker places beside it."
STACK_OPTIONS = {
    "start_mm": ("--from", "lowest slice along the table (mm)"),
    "stop_mm": ("--to", "highest slice along the table (mm)"),
    "spacing_mm": ("--spacing", "distance between slices (mm)"),
    "thickness_mm": ("--thickness", "slice thickness (mm; default: the spacing)"),
    "field_of_view_mm": ("--field-of-view", "width of the image (mm)"),
    "tilt_deg": ("--tilt", "gantry tilt (degrees)"),
}
SCANNER_OPTIONS = {
    "dose": ("--dose", "dose relative to a usual head scan; 0 leaves noise out"),
    "kilovolts": ("--kilovolts", "tube voltage (kV)"),
    "scatter": ("--scatter", "strength of scattered radiation, such as 0.02"),
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("scene", metavar="SCENE", nargs="?", help="a ready-made scene (see --list) or a TOML file")
    parser.add_argument("-o", "--output", metavar="DIR", help="folder to write; an earlier phantom is replaced")
    parser.add_argument(
        "--list", action="store_true", help="show the ready-made scenes and the protocols and stop"
    )
    parser.add_argument(
        "--protocol", metavar="NAME", help="scan a random patient as hospitals do (see --list); drawn with --seed"
    )
    parser.add_argument(
        "--scanner",
        choices=("projection", "fast"),
        default="projection",
        help="full physics (default), or the quick renderer without streaks",
    )
    parser.add_argument("--seed", type=whole(0), metavar="N", help="seed of the noise, and of random-patient")
    parser.add_argument("--kernel", metavar="NAME", help="reconstruction kernel, from very soft to strong edge")
    parser.add_argument("--matrix", type=whole(), metavar="N", help="pixels along each edge of the image")
    for name, (option, text) in {**STACK_OPTIONS, **SCANNER_OPTIONS}.items():
        parser.add_argument(option, dest=name, type=number, metavar="X", help=text)
    parser.add_argument("--extended-scale", action="store_true", help="keep values above 3071 HU")
    parser.add_argument("--padding", type=number, metavar="HU", help="value outside the circle of reconstruction")
    parser.add_argument(
        "--order",
        choices=("ascending", "descending", "shuffled"),
        default="ascending",
        help="of the slices in the files' names (default %(default)s)",
    )
    parser.add_argument(
        "--transfer-syntax",
        metavar="NAME",
        default="explicit",
        help="explicit, implicit, deflated, rle, jpeg-ls or jpeg-2000 (default %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Scan ``arguments.scene`` and write it to ``arguments.output``."""
    from phantoms.errors import PhantomError
    from ronnaplan.errors import InputError, UsageError
    from ronnaplan.text import counted

    if arguments.list:
        return _list()
    if not (arguments.scene and arguments.output):
        raise UsageError("a scene and -o DIR are needed (see 'ronnaplan phantom --list' for ready-made scenes)")
    try:
        examination, options = _asked(arguments)
    except PhantomError as error:  # no scene has, and no scanner takes, what an option says
        raise UsageError(str(error)) from error
    _warn(examination)
    try:
        examination.write(
            arguments.output, options, fast=arguments.scanner == "fast", progress=sys.stderr.isatty()
        )
    except PhantomError as error:
        raise InputError(str(error)) from error
    tell(
        f"wrote {counted(len(examination.stack), 'slice')} and truth.json with "
        f"{counted(len(examination.scene.markers), 'marker')} to {arguments.output}"
    )
    return 0


def _asked(arguments: argparse.Namespace) -> tuple[Examination, SeriesOptions]:
    """Return the examination that is asked for, and how its series is written."""
    from dataclasses import replace

    from phantoms.errors import PhantomError
    from phantoms.fast import Renderer

    examination = _changed(_scene(arguments), arguments)
    fast = arguments.scanner == "fast"
    if arguments.scatter is not None and (fast or isinstance(examination.scanner, Renderer)):
        raise PhantomError("the fast renderer scatters nothing; leave --scatter out, or choose another scanner")
    return examination, replace(
        examination.options(fast=fast),
        order=arguments.order,
        padding_hu=arguments.padding,
        transfer_syntax=arguments.transfer_syntax,
    )


def _scene(arguments: argparse.Namespace) -> Examination:
    """Return the scene as it is ready-made or its file says; raises `InputError` for a file that is none."""
    from phantoms.errors import PhantomError
    from phantoms.library import READY, ready
    from phantoms.patients import random_patient
    from phantoms.scene_file import read_scene
    from ronnaplan.errors import InputError

    if arguments.scene == "random-patient" and (arguments.seed is not None or arguments.protocol):
        return random_patient(arguments.seed or 0, protocol=arguments.protocol)
    if arguments.protocol:
        raise PhantomError(f"a protocol scans random-patient only, not {arguments.scene}; leave one of them out")
    if arguments.scene in READY or not arguments.scene.lower().endswith(".toml"):
        return ready(arguments.scene)
    try:
        return read_scene(arguments.scene)
    except PhantomError as error:
        raise InputError(str(error)) from error


def _changed(examination: Examination, arguments: argparse.Namespace) -> Examination:
    """Return an examination with the options of the command line applied to it."""
    from dataclasses import replace

    names = [*STACK_OPTIONS, "matrix"]
    geometry = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    if geometry:
        examination = replace(examination, stack=examination.stack.changed(**geometry))
    names = [*SCANNER_OPTIONS, "kernel"]
    changes = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    if arguments.extended_scale:
        changes["extended_scale"] = True
    seed = examination.seed if arguments.seed is None else arguments.seed
    return replace(examination, scanner=replace(examination.scanner, **changes), seed=seed)


def _warn(examination: Examination) -> None:
    """Name the markers that the scan cuts or misses."""
    stack, markers = examination.stack, examination.scene.markers
    cut = [marker.label for marker in markers if not stack.holds_whole(marker.center_mm, marker.diameter_mm)]
    if cut:
        tell(f"ronnaplan: not whole in the scan (flagged in truth.json): {', '.join(cut)}")


def _list() -> int:
    """Print every ready-made scene with its picture, and every protocol."""
    from phantoms.library import READY, ready
    from phantoms.picture import draw
    from phantoms.protocols import PROTOCOLS

    for name, (text, _) in READY.items():
        examination = ready(name)
        sizes = " and ".join(
            f"{size:g}" for size in sorted({one.diameter_mm for one in examination.scene.markers})
        )
        told = f"{text}; markers of {sizes} mm" if sizes else text
        print(f"{name}: {told}\n\n{draw(examination.scene, examination.stack)}\n")
    print("● marker   █ metal   ▒ bone, tooth   ░ plastic   · tissue")
    print("\nprotocols, for random-patient:")
    for name, (text, _) in PROTOCOLS.items():
        print(f"  {name}: {text}")
    return 0
