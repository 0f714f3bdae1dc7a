"""The ``ronnaplan`` command: one module a verb, imported only when that verb (or its help) is asked for."""

from __future__ import annotations

import argparse
import atexit
import gc
import io
import os
import re
import stat
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from ronnaplan import __version__
from ronnaplan.cli.output import discard_output, guarded_output
from ronnaplan.errors import InputError, RonnaplanError, UsageError, wants_room
from ronnaplan.text import NOTICE, printable

VERBS = (
    *("series", "localize", "plan", "track", "register", "view", "report", "export", "robot"),
    *("cohort", "node", "pull", "phantom", "phantom-check", "study", "demo", "prepare", "schema"),
)

DESCRIPTION = "From a head CT with spherical markers to coordinates a robot can trust."

OBJECTS_BETWEEN_COLLECTIONS = 300_000
"""Python looks for circles of garbage after so many new objects, not after 700: imports make many (those of localizing
200,000) and drop none."""

KEPT_SMALL = {
    "PYDANTIC_DISABLE_PLUGINS": "true",  # else pydantic reads what every installed package declares
    "OPENBLAS_NUM_THREADS": "1",  # else numpy and scipy keep each further processor busy for 0.1 s, waiting for work
}
"""Of the libraries, for this process and those that it begins; what a person has set stays."""

NO_INPUTS = frozenset({"output", "to", "name"})
"""What may be the name of a file that is written, but names none that is read: formats, and kinds of documents."""

NEGATIVE = re.compile(r"-(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?$")
"""What begins with a minus and is a number."""

GIVEN = "_given"
"""Where parsing keeps which options it met."""


class _Once(argparse.Action):
    """Keeps an option's value; the option given again is wrong usage, for argparse would keep the last silently."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option: str | None = None,
    ) -> None:
        given: set[str] = vars(namespace).setdefault(GIVEN, set())
        if option is not None and self.dest in given:
            raise argparse.ArgumentError(self, "is given twice; give it once")
        _require_said(self, values)
        given.add(self.dest)
        setattr(namespace, self.dest, values)


class _Each(argparse.Action):
    """Keeps what an option was given each time."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option: str | None = None,
    ) -> None:
        _require_said(self, values)
        setattr(namespace, self.dest, [*(getattr(namespace, self.dest) or ()), values])


def _require_said(action: argparse.Action, values: Any) -> None:
    """Refuse an empty value, as a script's variable that is not set leaves it: it would count as none, or as here."""
    if values == "" or (isinstance(values, list) and "" in values):
        raise argparse.ArgumentError(action, "is empty; say what it is, or leave it out")


class _Parser(argparse.ArgumentParser):
    """Reports wrong usage as one sentence and exit status 2, like every other error."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._negative_number_matcher = NEGATIVE  # before Python 3.14 argparse takes -1.5e-05 for an option
        for name, action in ((None, _Once), ("store", _Once), ("append", _Each)):
            self.register("action", name, action)

    def error(self, message: str) -> None:  # type: ignore[override]
        raise UsageError(f"{message} (see '{self.prog} --help')")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit status: 0 done, 1 unusable input, 2 wrong usage, 3 refused."""
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    atexit.register(gc.freeze)  # else Python searches all that was imported for garbage, twice, before it ends
    for name, value in KEPT_SMALL.items():
        os.environ.setdefault(name, value)
    _let_any_text_out()
    with guarded_output():
        try:
            return _run(arguments)
        except RonnaplanError as error:
            print(f"ronnaplan: {error}", file=sys.stderr)
            return error.exit_status
        except BrokenPipeError:
            # The reader of our output (head, less) went away: not an error, and nothing more can be written.
            discard_output()
            return 0
        except OSError as error:
            print(f"ronnaplan: {_told(error)}", file=sys.stderr)
            return InputError.exit_status
        except KeyboardInterrupt:
            print("ronnaplan: stopped; no file was left half-written", file=sys.stderr)
            return 130


def _told(error: OSError) -> str:
    """Return a sentence for what the system says of a file; raises ``error`` where it says nothing of one."""
    if error.filename is not None:
        # Even to ask whether a file exists fails in a folder that is closed to this user, or with too long a name.
        named = printable(os.fsdecode(error.filename))
        return f"{named}: {error.strerror}; name another path, or get access to it"
    if wants_room(error):
        told = printable(error.strerror or error)
        return f"{told}; make room on the disk, or name another folder for temporary files by TMPDIR"
    raise error


def _run(arguments: Sequence[str] | None) -> int:
    try:
        parsed = parse(arguments)
        _require_inputs_kept(vars(parsed))
        status: int = parsed.run(parsed)
    finally:  # of --help, too
        sys.stdout.flush()
    return status


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return what a command line says; its ``run`` does it. Raises `UsageError`."""
    given = sys.argv[1:] if arguments is None else arguments
    named = [verb for verb in VERBS if verb in given[:1]]
    parsed = command_parser(named or VERBS).parse_args(given)
    if vars(parsed).get("output") == "-":  # by which other programs mean standard output
        raise UsageError("-o - names no file; leave -o out for standard output, where that is its default")
    return parsed


def _require_inputs_kept(given: Mapping[str, object]) -> None:
    """Raise `UsageError` where the file to write is one that is read, or a scan's: what is replaced is lost."""
    output = _file(given.get("output"))
    for name, value in given.items():
        named = value if isinstance(value, (list, tuple)) else (value,)
        if output is not None and name not in NO_INPUTS and output in map(_file, named):
            raise UsageError(
                f"-o {given['output']} is a file that is read here, and would be lost; name another one"
            )
    if output is not None and _is_scanned(str(given["output"])):
        raise UsageError(f"-o {given['output']} is a DICOM image, and would be lost; name another file")


def _is_scanned(path: str) -> bool:
    """Whether a file is a DICOM image, which no verb writes to a single file: one of a folder that is read, say."""
    from ronnaplan.ct.files import DiskFile
    from ronnaplan.ct.header import read_header
    from ronnaplan.ct.limits import Limits

    status = Path(path).stat()
    try:
        header = read_header(DiskFile(path, status.st_size, status.st_mtime_ns), Limits())
    except InputError:
        return False
    return header.pixel_tag is not None


def _file(named: object) -> tuple[int, int] | None:
    """Return what tells the regular file that an argument names from all others; None where it names none."""
    try:
        found = Path(named).stat() if isinstance(named, str) else None
    except (OSError, ValueError):  # as where it is no name of a file at all
        return None
    return (found.st_dev, found.st_ino) if found is not None and stat.S_ISREG(found.st_mode) else None


def _let_any_text_out() -> None:
    """Replace what a terminal's encoding lacks (a table's symbols, say) instead of failing.

    Standard output that goes into a file or to a program is UTF-8, as what ``-o`` writes, unless its encoding was asked
    for: Windows would take the letters of a region, and other ends of lines.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if isinstance(sys.stdout, io.TextIOWrapper) and not (sys.stdout.isatty() or "PYTHONIOENCODING" in os.environ):
        sys.stdout.reconfigure(encoding="utf-8", errors="replace", newline="\n")


def command_parser(names: Iterable[str] = VERBS) -> argparse.ArgumentParser:
    """Return what parses these verbs; the module of each is loaded for it."""
    parser = _Parser(prog="ronnaplan", description=DESCRIPTION, epilog=NOTICE)
    parser.add_argument("--version", action="version", version=f"ronnaplan {__version__}")
    verbs = parser.add_subparsers(metavar="VERB", required=True, parser_class=_Parser)
    for name in names:
        module = import_module(f"ronnaplan.cli.{name.replace('-', '_')}")
        verb = verbs.add_parser(name, help=module.HELP, description=module.HELP, epilog=NOTICE)
        module.configure(verb)
        verb.set_defaults(run=module.run)
    return parser
