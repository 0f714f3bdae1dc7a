"""``ronnaplan view``: the planner in a browser on this machine."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from ronnaplan.cli.case_options import rules, with_documents, with_paper, with_rules
from ronnaplan.cli.peers import PEER, peer_of, with_config
from ronnaplan.cli.values import whole
from ronnaplan.extras import require_packages
from ronnaplan.text import whole_number

if TYPE_CHECKING:
    from ronnaplan.planner.address import Address
    from ronnaplan.planner.handing import Origin
    from ronnaplan.planner.shelves import Shelf
    from ronnaplan.planner.state import PlannerState
    from ronnaplan.planner.storage import Storage
    from ronnaplan.scene.vtk import Workshop

HELP = "Open the planner: a local web page with the scan, its markers, trajectories and registration."

SCAN_TOO = "name its scan, too: ronnaplan view CT"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "ct",
        metavar="CT",
        nargs="?",
        help="a DICOM folder, file or zip archive, or an image (default: ct beside the plan, or the images there)",
    )
    parser.add_argument("--series", metavar="UID", help="the series to use, where CT holds several")
    parser.add_argument(
        "--root",
        metavar="FOLDER",
        help="begin with a page on which a scan is looked for below this folder, or dropped (default without a scan: "
        "the present folder)",
    )
    parser.add_argument(
        "--peer", metavar="PEER", help=f"list an archive's series on that page, too, and fetch one: {PEER}"
    )
    with_config(parser)
    parser.add_argument(
        "--plan", metavar="FILE", help="plan.json, made if it is not there (default: in the present folder)"
    )
    with_documents(parser, otherwise="beside the plan")
    with_rules(parser)
    parser.add_argument(
        "--second",
        metavar="IMAGE",
        help="another image of the same head (DICOM series of MR or CT; NIfTI, NRRD, MetaImage) to show over the cuts",
    )
    parser.add_argument(
        "--labels",
        action="append",
        default=[],
        metavar="LABELS",
        help="a label map (NIfTI, NRRD, MetaImage, DICOM SEG) to show; nothing is judged by it; repeatable",
    )
    with_paper(parser)
    parser.add_argument("--tracker", metavar="HOST:PORT", help="an OpenIGTLink server to listen to when asked")
    parser.add_argument(
        "--patient", action="store_true", help="show the patient's name, which is left out otherwise"
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    parser.add_argument(
        "--port", type=whole(0, 65_535), default=0, help="port to listen on (default: any that is free)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Open the case and serve it until stopped."""
    require_packages("the planner", "planner", "trame", "aiohttp")
    _require_files(arguments.fiducials, arguments.registration)
    _require_root(arguments.root)
    from ronnaplan.case.folder import scan_in
    from ronnaplan.planner.storage import Storage

    storage = Storage.of(arguments.plan, arguments.fiducials, arguments.registration, arguments.limits)
    planner = _Planner(arguments)
    ct = None if arguments.root or arguments.peer else arguments.ct or scan_in(storage.plan.parent)
    if ct is not None:
        planner.serve(planner.open(Path(ct), arguments.series, storage), None)
    else:
        _require_no_case(arguments)
        planner.serve_any(storage.plan.parent)
    return 0


class _Planner:
    """Opens and serves cases as the options say; ``origin`` and ``workshop`` are those of the case opened last."""

    origin: Origin
    workshop: Workshop

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.tracker = _address(arguments.tracker) if arguments.tracker else None

    def open(self, ct: Path, series: str | None, storage: Storage) -> PlannerState:
        """Read a scan and return its case, which is to be served next."""
        from ronnaplan.case.folder import read_labels, with_limits
        from ronnaplan.ct import read_ct
        from ronnaplan.ct.reader import read_other_image
        from ronnaplan.planner.handing import Origin
        from ronnaplan.planner.state import PlannerState
        from ronnaplan.scene.vtk import Workshop

        given = self.arguments
        stated = with_limits(rules(given), Path(given.limits) if given.limits else None)
        with ExitStack() as undone:
            workshop = undone.enter_context(Workshop())  # its libraries are loaded while the scan is read
            volume = read_ct(ct, series, progress=True)
            no_go, labels = (read_labels(paths, volume) for paths in (given.no_go, given.labels))
            state = PlannerState(volume, storage, stated, no_go, labels)
            if given.second:
                state.take_second(read_other_image(given.second, progress=True), Path(given.second).name)
            undone.pop_all()
        self.origin, self.workshop = Origin(ct, series, _stated(given), _regions(given), given.paper), workshop
        return state

    def serve(self, state: PlannerState, address: Address | None) -> bool:
        """Serve the case opened last, where a start page was if there is an ``address``; as `server.serve` does."""
        from ronnaplan.planner.server import serve

        with self.workshop:
            return serve(
                state,
                host=self.arguments.host,
                port=self.arguments.port,
                tracker=self.tracker,
                patient=_patient(self.origin.ct, self.origin.series) if self.arguments.patient else None,
                origin=self.origin,
                address=address,
                workshop=self.workshop,
            )

    def serve_any(self, home: Path) -> None:
        """Serve the start page, then the case that is opened there, and so on until it is stopped."""
        from ronnaplan.planner.server import start
        from ronnaplan.planner.starting import StartPage
        from ronnaplan.planner.storage import Storage

        given, address, left = self.arguments, None, True
        while left:
            page = StartPage(
                home,
                Path(given.root or home),
                lambda ct, series, plan: self.open(ct, series, Storage.of(str(plan), None, None, given.limits)),
                _shelf(given) if given.peer else None,
            )
            state, address = start(page, host=given.host, port=given.port, address=address)
            del page  # which holds the case
            left = self.serve(state, address)
            del state


def _shelf(arguments: argparse.Namespace) -> Shelf:
    """Return what the archive has that was named."""
    config, peer = peer_of(arguments)
    from ronnaplan.node.browse import Shelf

    return Shelf(config, peer, names=arguments.patient)


def _require_no_case(arguments: argparse.Namespace) -> None:
    """Refuse what belongs to one case where none was named: the start page opens any."""
    from ronnaplan.case.folder import CT_FOLDER
    from ronnaplan.errors import UsageError

    if arguments.plan and not (arguments.root or arguments.peer):
        plan = Path(arguments.plan).resolve()
        raise UsageError(
            f"no CT lies in {plan.parent / CT_FOLDER} or beside {plan.name}; name one: ronnaplan view CT"
        )
    named = {"CT": arguments.ct, "--series": arguments.series, "--fiducials": arguments.fiducials}
    named |= {"--registration": arguments.registration, "--no-go": arguments.no_go, "--plan": arguments.plan}
    named |= {"--second": arguments.second, "--labels": arguments.labels}
    given = [name for name, value in named.items() if value]
    start = next(
        (name for name, value in {"--root": arguments.root, "--peer": arguments.peer}.items() if value), ""
    )
    if given:
        belong = f"{' and '.join(given)} belong{'s' if len(given) == 1 else ''} to one case"
        how = f"leave out {start}, with which all begins at the start page" if start else SCAN_TOO
        raise UsageError(f"{belong}; {how}")


def _stated(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return what was stated as options of ``ronnaplan report``."""
    stated = ["--sigma-ct", str(arguments.sigma_ct), "--sigma-ots", str(arguments.sigma_ots)]
    stated += ["--limits", str(Path(arguments.limits).resolve())] if arguments.limits else []
    stated += _named("--no-go", arguments.no_go)
    if arguments.frame_axes:
        stated += ["--frame-axes", *map(str, arguments.frame_axes)]
    return tuple(stated)


def _regions(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return which label maps were named as options of ``ronnaplan export``."""
    return (*_named("--no-go", arguments.no_go), *_named("--labels", arguments.labels))


def _named(option: str, paths: Sequence[str]) -> list[str]:
    return [part for path in paths for part in (option, str(Path(path).resolve()))]


def _require_files(*named: str | None) -> None:
    """Refuse a document that was named and is not there: to go on without it would be another case."""
    from ronnaplan.errors import InputError

    for name in named:
        if name is not None and not Path(name).is_file():
            raise InputError(f"{name} does not exist; name a document that does, or none to begin anew")


def _require_root(root: str | None) -> None:
    """Refuse a root that is no folder: the start page would have nothing to look through."""
    from ronnaplan.errors import InputError

    if root is not None and not Path(root).is_dir():
        raise InputError(f"{root} is no folder; name one whose scans are to be chosen from")


def _patient(ct: str | Path, series_uid: str | None) -> str:
    """Return the patient's name in the scan, empty where it holds none."""
    from ronnaplan.ct import find_series
    from ronnaplan.ct.images import is_image_file

    return "" if is_image_file(Path(ct)) else find_series(ct).choose(series_uid).first.patient_name


def _address(text: str) -> tuple[str, int]:
    from ronnaplan.errors import UsageError

    host, colon, port = text.rpartition(":")
    number = whole_number(port)
    if not (host and colon and number is not None and 0 < number < 65_536):
        raise UsageError(f"--tracker {text} is not of the form HOST:PORT, such as localhost:18944")
    return host, number
