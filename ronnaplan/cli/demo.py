"""``ronnaplan demo``: the whole way on the synthetic CT that comes with the source."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

HELP = "Localize the markers of data/synthetic_ct, compare with the known truth, and draw them."
DATA = Path(__file__).resolve().parents[2] / "data" / "synthetic_ct"

NEXT = """
What to try next{first}:
  ronnaplan register {folder}/fiducials.json {data}/readings.csv -o {folder}/registration.json
  ronnaplan export {folder}/fiducials.json --to markups -o {folder}/fiducials.mrk.json    # for 3D Slicer
  ronnaplan localize YOUR_SCAN --diameter auto -o fiducials.json
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "--output-dir", metavar="DIR", default="out/demo", help="where to write (default: %(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Localize, compare, draw, and say where everything is."""
    from ronnaplan.ct import read_ct
    from ronnaplan.documents.fiducials import fiducials_document, read_fiducials
    from ronnaplan.documents.files import make_folder, read_json, write_atomically
    from ronnaplan.documents.revision import write_document
    from ronnaplan.errors import InputError
    from ronnaplan.localization import localize
    from ronnaplan.report.picture import marker_sheet
    from ronnaplan.report.tables import fiducials_table
    from ronnaplan.text import NOTICE

    if not DATA.is_dir():
        raise InputError(f"{DATA} does not exist; run the demo from a clone of the project's source")
    truth = read_json(DATA / "truth.json")["markers"]
    volume = read_ct(DATA)
    found = localize(volume, diameter_mm=truth[0]["diameter_mm"], expected=len(truth))
    print(fiducials_table(found, truth_mm=[marker["center"] for marker in truth]))
    folder = make_folder(arguments.output_dir)
    write_document(folder / "fiducials.json", fiducials_document(found), read_fiducials)
    write_atomically(folder / "markers.png", marker_sheet(volume, found))
    print(f"\nFiducials: {folder / 'fiducials.json'}\nPicture:   {folder / 'markers.png'}")
    print(NEXT.format(first=_first(), data=_shown(DATA), folder=folder))
    print(NOTICE)
    return 0


def _first() -> str:
    """Say how the command is found, where it is not: `scripts/demo` calls it in an environment that is not active."""
    if shutil.which("ronnaplan"):
        return ""
    here = {"bin": ". ", "Scripts": ""}  # POSIX; Windows
    ways = [(word, Path(sys.prefix) / folder / "activate") for folder, word in here.items()]
    return "".join(f" (after '{word}{_shown(script)}')" for word, script in ways if script.is_file())


def _shown(path: Path) -> Path:
    """Return the path as it is written from here."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
