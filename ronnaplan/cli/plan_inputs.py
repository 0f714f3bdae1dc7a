"""What actions of ``ronnaplan plan`` have in common: how plan, scan and options are read, and a change is written."""

from __future__ import annotations

import argparse
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ronnaplan.cli.output import warn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ronnaplan.ct import CTVolume
    from ronnaplan.geometry import FloatArray
    from ronnaplan.planning import Instrument, Plan


def read_scan(arguments: argparse.Namespace) -> CTVolume:
    """Return the scan that is named."""
    from ronnaplan.ct import read_ct

    return read_ct(arguments.ct, arguments.series, progress=True)


def scan_of_plan(arguments: argparse.Namespace) -> CTVolume:
    """Read the scan and require that it is the plan's, if there is a plan."""
    volume = read_scan(arguments)
    if arguments.plan:
        read_named_plan(arguments).require_scan(volume)
    return volume


def read_named_plan(arguments: argparse.Namespace) -> Plan:
    """Return the plan that is named."""
    from ronnaplan.documents.plan import read_plan

    return read_plan(arguments.plan)


def change_named(arguments: argparse.Namespace, change: Callable[[Plan], Plan]) -> int:
    """Make a change to the plan's file; returns the exit status."""
    from ronnaplan.documents.plan import change_plan

    change_plan(arguments.plan, change)
    return 0


def change_in_head(arguments: argparse.Namespace, change: Callable[[Plan], Plan]) -> int:
    """Make a change to the plan if the ends that are new in it lie in the head; warn of what makes them doubtful."""
    from ronnaplan.case.edits import sound
    from ronnaplan.documents.plan import change_plan
    from ronnaplan.planning import Head
    from ronnaplan.planning.crossings import find_crossings
    from ronnaplan.planning.measures import end_doubts

    change(read_named_plan(arguments))  # what is wrong without the scan is told before it is read
    head = Head.of(scan_of_plan(arguments))
    changed = change_plan(arguments.plan, lambda plan: sound(plan, change(plan), head))
    for one in changed.trajectories:
        above = find_crossings(head, one.target_mm, -one.inward)
        warn(*end_doubts(one, above, head, changed.landmarks))
    return 0


def lps(place: list[float], system: str | None) -> FloatArray:
    """Return a place (3,) in LPS mm, given in the coordinate ``system``; raises `UsageError` where none is named."""
    import numpy as np

    from ronnaplan.documents.plan_exchange import to_lps
    from ronnaplan.errors import UsageError

    if system is None:
        raise UsageError("coordinates need --coordinates LPS or --coordinates RAS")
    return to_lps(np.array(place, dtype=np.float64), system)


def require_places(arguments: argparse.Namespace, *names: str) -> None:
    """Raise `UsageError` where a coordinate system is named and none of the options ``names`` that it is of."""
    from ronnaplan.errors import UsageError

    if arguments.coordinates is not None and all(getattr(arguments, name) is None for name in names):
        stated = " or ".join(f"--{name}" for name in names)
        raise UsageError(f"--coordinates is the system of {stated}, which is not given; give both or neither")


def stated_target(arguments: argparse.Namespace) -> Callable[[Plan], FloatArray] | None:
    """Return what gives the target (3,), LPS mm, that was stated, of a plan whose AC-PC frame may count; None without.

    Raises `UsageError` where a coordinate system is missing; what it returns raises `InputError` without a frame.
    """
    from ronnaplan.planning.angles import lps_from_acpc

    if arguments.target_acpc is not None:
        return lambda plan: lps_from_acpc(plan.acpc, arguments.target_acpc)
    if arguments.target is None:
        return None
    place_mm = lps(arguments.target, arguments.coordinates)
    return lambda _: place_mm


def stated_electrode(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the electrode that was chosen by name, as a trajectory takes it; nothing where none was named."""
    from ronnaplan.planning.electrodes import electrode_chosen

    if arguments.electrode is None:
        return {}
    with _said_by_options():
        return {"electrode": electrode_chosen(arguments.electrode)}


def stated_instrument(arguments: argparse.Namespace) -> Instrument | None:
    """Return the instrument that was named or sized; None where none was."""
    from ronnaplan.errors import UsageError
    from ronnaplan.planning import Instrument
    from ronnaplan.planning.trajectory import instrument_named

    if (arguments.diameter is None) != (arguments.length is None):
        raise UsageError("an instrument of your own needs both --diameter and --length")
    with _said_by_options():
        if arguments.diameter is not None:
            return Instrument(arguments.instrument or "instrument", arguments.diameter, arguments.length)
        return instrument_named(arguments.instrument) if arguments.instrument else None


@contextmanager
def _said_by_options() -> Iterator[None]:
    """Take what no catalogue has, and no instrument can be, for wrong usage: options alone said it, no file."""
    from ronnaplan.errors import InputError, UsageError

    try:
        yield
    except InputError as error:
        raise UsageError(str(error)) from error
