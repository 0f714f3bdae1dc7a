"""Options that several verbs share, most of them what trajectories are judged against."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from ronnaplan.cli.values import number, sigma_mm, whole
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM

if TYPE_CHECKING:
    from ronnaplan.case.folder import Case
    from ronnaplan.case.surroundings import Rules
    from ronnaplan.geometry import FloatArray

USUAL_PAPER: Final = "A4"
"""What a report is printed on where nothing is said of it."""


class Declares(Protocol):
    """A parser, or a group of its arguments."""

    def add_argument(self, *names: str, **how: Any) -> argparse.Action:
        """Declare an argument."""


def with_sigmas(parser: Declares) -> None:
    """Declare the errors of the markers that count where a document states no others."""
    with_sigma_ct(parser)
    with_sigma_ots(parser)


def with_sigma_ct(parser: Declares) -> None:
    """Declare the error of a marker in CT."""
    parser.add_argument(
        "--sigma-ct",
        type=sigma_mm,
        default=SIGMA_CT_MM,
        metavar="MM",
        help="a marker's error in CT per axis, beyond CT noise (default %(default)s: skin markers)",
    )


def with_sigma_ots(parser: Declares) -> None:
    """Declare the error of what the tracker reads."""
    parser.add_argument(
        "--sigma-ots",
        type=sigma_mm,
        default=SIGMA_OTS_MM,
        metavar="MM",
        help="the tracker's error per axis (default %(default)s)",
    )


def with_server(parser: Declares) -> None:
    """Declare where a tracker's OpenIGTLink server is."""
    parser.add_argument("--host", default="127.0.0.1", help="where the server runs (default %(default)s)")
    parser.add_argument("--port", type=whole(1, 65_535), default=18944, help="its port (default %(default)s)")


def with_paper(parser: Declares) -> None:
    """Declare the size of a report's pages."""
    parser.add_argument(
        "--paper",
        choices=(USUAL_PAPER, "Letter"),
        help=f"what a report is printed on (default: {USUAL_PAPER})",
    )


def with_rules(parser: argparse.ArgumentParser) -> None:
    """Declare what a person states before trajectories are judged."""
    parser.add_argument("--limits", metavar="FILE", help="limits.json that trajectories are held against")
    parser.add_argument(
        "--no-go",
        action="append",
        default=[],
        metavar="LABELS",
        help="a label map (NIfTI, NRRD, MetaImage, DICOM SEG) to keep away from; repeatable",
    )
    with_sigmas(parser)
    parser.add_argument(
        "--frame-axes",
        nargs=9,
        type=number,
        metavar="N",
        help="right, anterior, superior of the stereotactic frame in LPS, three numbers each (default: the scanner's)",
    )


def with_documents(parser: argparse.ArgumentParser, *, otherwise: str = "none") -> None:
    """Declare the documents of the markers; ``otherwise`` says what is taken where one is not named."""
    parser.add_argument(
        "--fiducials",
        metavar="FILE",
        help=f"fiducials.json: markers to avoid and to register by (default: {otherwise})",
    )
    parser.add_argument(
        "--registration",
        metavar="FILE",
        help=f"registration.json: the expected error is that of this registration (default: {otherwise})",
    )


def rules(arguments: argparse.Namespace) -> Rules:
    """Return what was stated, but for the limits, which are a document of the case."""
    from ronnaplan.case.surroundings import Rules

    return Rules(
        sigma_ct_mm=arguments.sigma_ct,
        sigma_ots_mm=arguments.sigma_ots,
        frame_axes=_frame_axes(arguments.frame_axes),
    )


def read_named_case(arguments: argparse.Namespace) -> Case:
    """Return the case of the documents and the scan that were named, one by one."""
    from ronnaplan.case.folder import CaseFiles, read_case
    from ronnaplan.ct import read_ct

    names = (arguments.plan, arguments.fiducials, arguments.registration, arguments.limits)
    stated = rules(arguments)
    files = CaseFiles(*(Path(name) if name else None for name in names))
    return read_case(
        files, lambda: read_ct(arguments.ct, arguments.series, progress=True), stated, arguments.no_go
    )


def unnamed_documents(arguments: argparse.Namespace) -> list[str]:
    """Say which documents lie beside the plan, where the planner takes them from, and were not named here."""
    from ronnaplan.case.folder import FIDUCIALS, LIMITS, REGISTRATION

    named = {
        "fiducials": (FIDUCIALS, arguments.fiducials),
        "registration": (REGISTRATION, arguments.registration),
        "limits": (LIMITS, arguments.limits),
    }
    return [
        f"{name} lies beside the plan and does not count here; name it with --{option}"
        for option, (name, given) in named.items()
        if given is None and Path(arguments.plan).with_name(name).is_file()
    ]


def _frame_axes(numbers: list[float] | None) -> FloatArray:
    """Return the stereotactic frame's right, anterior, superior in LPS as rows (3, 3)."""
    import numpy as np

    from ronnaplan.planning.angles import RAS_IN_LPS
    from ronnaplan.pose import as_pose
    from ronnaplan.transforms import rigid

    if numbers is None:
        return RAS_IN_LPS
    return as_pose(rigid(np.array(numbers).reshape(3, 3), np.zeros(3)), "--frame-axes")[:3, :3]
