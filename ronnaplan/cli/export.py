"""``ronnaplan export``: a result in another tool's format."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "Turn fiducials or a registration into markups, CSV, DICOM or an ITK transform, or a case into a 3-D scene."
DOCUMENTS = ("markups", "csv", "dicom", "itk")
SCENES = ("gltf", "stl", "vtp", "html")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "file", metavar="FILE", help="a fiducials.json or registration.json; for a 3-D scene the folder of a case"
    )
    parser.add_argument("--to", required=True, choices=DOCUMENTS + SCENES, help="the format to write")
    parser.add_argument(
        "--ct",
        metavar="PATH",
        help="the scan: whose patient and study a DICOM object is to name (default: none), or whose head a scene shows "
        "(default: the case's)",
    )
    parser.add_argument("-o", "--output", metavar="OUT", help="file to write (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Export ``arguments.file``."""
    from ronnaplan.documents.export import export
    from ronnaplan.documents.files import write_atomically, write_result
    from ronnaplan.errors import UsageError

    to, is_case = arguments.to, Path(arguments.file).is_dir()
    if is_case != (to in SCENES):
        known = ", ".join(SCENES if is_case else DOCUMENTS)
        raise UsageError(
            f"{arguments.file} cannot become '{to}'; choose one of {known}, or give a {_other(is_case)}"
        )
    exported = _scene(arguments) if is_case else export(arguments.file, to, arguments.ct)
    if isinstance(exported, str):
        write_result(arguments.output, exported)
    elif arguments.output is None:
        raise UsageError(f"'{to}' is not text for a terminal; name its file with -o")
    else:
        write_atomically(arguments.output, exported)
    return 0


def _other(is_case: bool) -> str:
    return "fiducials.json or registration.json" if is_case else "case's folder"


def _scene(arguments: argparse.Namespace) -> bytes:
    """Return the scene of a case as a file."""
    from ronnaplan.case.folder import CaseFiles, read_case, read_scan
    from ronnaplan.errors import UsageError
    from ronnaplan.scene.contents import things_of
    from ronnaplan.scene.files import WRITERS, html
    from ronnaplan.scene.head import still_png

    if arguments.output is None:
        raise UsageError(f"'{arguments.to}' is not text for a terminal; name its file with -o")
    case = read_case(
        CaseFiles.of_folder(arguments.file), lambda: read_scan(arguments.file, arguments.ct, None, progress=True)
    )
    things = things_of(case)
    if arguments.to in WRITERS:
        return WRITERS[arguments.to](things)
    return html(things, "ronnaplan", still_png(things))
