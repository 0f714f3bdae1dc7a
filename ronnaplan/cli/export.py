"""``ronnaplan export``: a result in another tool's format."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ronnaplan.cli.output import library_warnings, tell, warn

HELP = (
    "Turn fiducials or a registration into markups, CSV, DICOM, an ITK transform, ROS or a map of the expected error, "
    "a case into a 3-D scene, or name nobody in a scan."
)
DOCUMENTS = ("markups", "csv", "dicom", "itk", "ros", "tre-map")
SCENES = {"gltf": (".glb",), "stl": (".stl",), "vtp": (".vtp",), "html": (".html", ".htm")}
"""Files of a 3-D scene, and what they must be called."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "file",
        metavar="FILE",
        help="a fiducials.json or registration.json; for a 3-D scene the folder of a case; a scan to deidentify",
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--to",
        choices=(*DOCUMENTS, *SCENES),
        help="the format to write; tre-map: the error to expect (mm RMS) at every voxel of --ct, .nii.gz, .nrrd, .mha",
    )
    what.add_argument(
        "--deidentify",
        action="store_true",
        help="write the DICOM files of FILE, naming nobody (PS3.15, basic profile), to the new folder OUT",
    )
    parser.add_argument(
        "--secret", metavar="FILE", help="with --deidentify: what new UIDs are made of (default: new each time)"
    )
    parser.add_argument(
        "--ct",
        metavar="PATH",
        help="the scan: whose patient and study a DICOM object is to name (default: none), whose voxels a map of the "
        "error is to have, or whose head a scene shows (default: the case's)",
    )
    parser.add_argument(
        "--series", metavar="UID", help="for a 3-D scene: the scan's series, where there are several"
    )
    for option, what_for in (("--no-go", "to keep away from"), ("--labels", "to show besides")):
        parser.add_argument(
            option,
            action="append",
            default=[],
            metavar="LABELS",
            help=f"for a 3-D scene: a label map (NIfTI, NRRD, MetaImage, DICOM SEG) {what_for}; repeatable",
        )
    parser.add_argument("-o", "--output", metavar="OUT", help="file to write (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Export ``arguments.file``."""
    if arguments.deidentify:
        return _deidentify(arguments)
    from ronnaplan.documents.export import export, write_as
    from ronnaplan.documents.files import check_target, require_ending, write_atomically
    from ronnaplan.errors import UsageError

    if arguments.secret is not None:
        raise UsageError("--secret goes with --deidentify; leave it out")
    to, is_case = arguments.to, Path(arguments.file).is_dir()
    if is_case != (to in SCENES):
        known = ", ".join(SCENES if is_case else DOCUMENTS)
        raise UsageError(
            f"{arguments.file} cannot become '{to}'; choose one of {known}, or give a {_other(is_case)}"
        )
    if not is_case and (arguments.no_go or arguments.labels or arguments.series):
        raise UsageError("only a 3-D scene takes --series, --no-go and --labels; give a case's folder")
    if arguments.output is not None:
        check_target(arguments.output)
        if is_case:
            require_ending(arguments.output, to, SCENES[to])
            write_atomically(arguments.output, _scene(arguments))
        else:
            with library_warnings():
                write_as(arguments.output, arguments.file, to, arguments.ct)
        return 0
    exported = None if is_case or to == "tre-map" else export(arguments.file, to, arguments.ct)
    if not isinstance(exported, str):
        raise UsageError(f"'{to}' is not text for a terminal; name its file with -o")
    sys.stdout.write(exported)
    return 0


def _other(is_case: bool) -> str:
    return "fiducials.json or registration.json" if is_case else "case's folder"


def _scene(arguments: argparse.Namespace) -> bytes:
    """Return the scene of a case as a file."""
    from ronnaplan.case.folder import CaseFiles, read_case, read_labels, read_scan
    from ronnaplan.scene.contents import things_of
    from ronnaplan.scene.files import WRITERS, html
    from ronnaplan.scene.portrait import still_png
    from ronnaplan.scene.vtk import Workshop

    case = read_case(
        CaseFiles.of_folder(arguments.file),
        lambda: read_scan(arguments.file, arguments.ct, arguments.series, progress=True),
        no_go=arguments.no_go,
    )
    if case.volume is None:
        warn("the scan is not at hand, so that no head is shown; give it with --ct")
    with Workshop() as workshop:
        labels = read_labels(arguments.labels, case.volume)
        things = things_of(workshop, case, labels=labels, robot=True, spreads=True)
        if arguments.to in WRITERS:
            return WRITERS[arguments.to](things)
        return html(things, "ronnaplan", still_png(workshop, things))


def _deidentify(arguments: argparse.Namespace) -> int:
    import secrets

    from ronnaplan.documents.deidentify import LEAST_SECRET_BYTES, deidentify
    from ronnaplan.errors import InputError, UsageError
    from ronnaplan.text import counted
    from ronnaplan.untrusted import read_whole

    if arguments.output is None or arguments.ct or arguments.series or arguments.no_go or arguments.labels:
        raise UsageError(
            "--deidentify writes all of FILE to a folder: name it with -o, and leave out --ct, --series, --no-go "
            "and --labels"
        )
    secret = secrets.token_bytes(LEAST_SECRET_BYTES)
    if arguments.secret is not None:
        secret = read_whole(arguments.secret, 1 << 16, expected="a file with a secret")
        if len(secret) < LEAST_SECRET_BYTES:
            raise InputError(
                f"{arguments.secret} holds {len(secret)} bytes; at least {LEAST_SECRET_BYTES} are needed"
            )
    count = deidentify(arguments.file, arguments.output, secret)
    tell(f"{counted(count, 'file')}, naming nobody, in {arguments.output}")
    return 0
