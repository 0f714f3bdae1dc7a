"""The files of a planner's case: read at the start, written after every change, so that nothing can be lost.

Only these files and dropped readings are ever written, and only readings that lie in the case's folder are read.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated

from pydantic import Field

from ronnaplan.case.folder import FIDUCIALS, LIMITS, PLACEMENT, PLAN, REGISTRATION, CaseFiles
from ronnaplan.documents.fields import DocumentModel, Hounsfield, Line, Matrix4, PositiveMm, Vector
from ronnaplan.documents.files import read_json, write_atomically
from ronnaplan.documents.reading import to_json, validated
from ronnaplan.errors import InputError, UsageError
from ronnaplan.planner.address import ADDRESS_FILE
from ronnaplan.planning.trajectory import COLOUR

PIVOT = "pivot.json"
"""The tip of a tool that is followed, in the case's folder."""

LAYOUTS = ("six", "four", "path", "3-D")
"""Standard cuts, head and two views of the path; the standard cuts and the head; both cuts in line with the path large;
the head large beside the cuts."""

LANDMARKS = ("AC", "PC", "midline")


class PlacedImage(DocumentModel):
    """Where another image lies: a rigid transform from the scan to it, and how far apart two starts ended, mm.

    ``exchanged`` are the sides of which its header seems to be wrong.
    """

    image_from_scan: Matrix4
    apart_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    exchanged: tuple[Line, ...] = ()


class ShownRegion(DocumentModel):
    """How a region is shown; ``opacity`` 0 hides it."""

    colour: Annotated[str, Field(pattern=rf"^{COLOUR.pattern}$")]
    opacity: Annotated[float, Field(ge=0.0, le=1.0)]


class Look(DocumentModel):
    """planner.json: where a person was looking, in the scan with these voxels."""

    voxel_sha256: Line
    crosshair: Vector
    center: Vector
    field_mm: PositiveMm
    window: Line
    window_hu: tuple[Hounsfield, Hounsfield] | None = None
    layout: Line = LAYOUTS[0]
    shown_as: Line = "skin"
    """A surface, or as what the scan is drawn whole."""
    selected: Line | None = None
    points: dict[Annotated[str, Field(pattern=f"^({'|'.join(LANDMARKS)})$")], Vector] = Field(default_factory=dict)
    """AC, PC or midline point as far as they are set, until the plan holds all three."""
    images: dict[str, PlacedImage] = Field(default_factory=dict)
    """Other images that were registered, by the SHA-256 of their voxels and of where they lie."""
    regions: dict[str, ShownRegion] = Field(default_factory=dict)
    """Regions that were given a colour or an opacity, by name."""


@dataclass(frozen=True)
class Storage:
    """Where the documents of a case lie."""

    plan: Path
    fiducials: Path
    registration: Path
    limits: Path

    @classmethod
    def of(
        cls, plan: str | None, fiducials: str | None, registration: str | None, limits: str | None = None
    ) -> Storage:
        """Name the files; what is not named lies beside the plan, the plan in the present folder."""
        path = Path(plan or PLAN).resolve()
        if not path.parent.is_dir():
            raise InputError(f"{path.parent} is not a folder; make it, or give another place for the plan")
        return cls(
            path,
            Path(fiducials).resolve() if fiducials else path.with_name(FIDUCIALS),
            Path(registration).resolve() if registration else path.with_name(REGISTRATION),
            Path(limits).resolve() if limits else path.with_name(LIMITS),
        )

    @property
    def documents(self) -> CaseFiles:
        """The documents of the case, there or not."""
        placement = self.plan.with_name(PLACEMENT)
        return CaseFiles(self.plan, self.fiducials, self.registration, self.limits, placement)

    @property
    def found(self) -> dict[str, Path]:
        """The documents that there are now, by the names they have in a case."""
        return {name: path for name, path in self.documents.named.items() if _is_file(path)}

    @property
    def _own_names(self) -> set[str]:
        """The documents of the case, which are no readings."""
        every = (*self.documents.named.values(), self.look, self.plan.with_name(PIVOT))
        return {path.name for path in every if path.parent == self.plan.parent}

    @property
    def look(self) -> Path:
        """The file that says where a person was looking."""
        return self.plan.with_name("planner.json")

    @property
    def address(self) -> Path:
        """The file that says where this case's planner is reached; only its user can read it."""
        return self.plan.with_name(ADDRESS_FILE)

    def read_look(self, voxel_sha256: str) -> Look | None:
        """Return where a person was looking in this scan, None where that is not known."""
        try:
            look = validated(read_json(self.look), Look, str(self.look), "it is not used")
        except InputError:
            return None  # nothing was planned with it: to look at the middle again loses nothing
        return look if look.voxel_sha256 == voxel_sha256 else None

    def write_look(self, look: Look) -> None:
        """Write where a person is looking."""
        write_atomically(self.look, to_json(look))

    def readings(self) -> list[str]:
        """Return the names of the files in the case's folder that begin as readings do; none while it is away."""
        try:
            files = [path for path in self.plan.parent.iterdir() if _is_file(path) and not path.is_symlink()]
        except OSError:
            return []
        return sorted(file.name for file in files if self.may_be_readings(file.name) and _begins_as_readings(file))

    def may_be_readings(self, name: str) -> bool:
        """Whether a file of that name may hold readings, and is none of the case's documents."""
        if name in self._own_names or name.startswith("."):
            return False
        from ronnaplan.tracking.readers import READERS  # not until there is something to read

        return Path(name).suffix.lower() in READERS

    def readings_path(self, name: str) -> Path:
        """Return where the readings file ``name`` lies; raises `UsageError` unless it is in the case's folder."""
        if name not in self.readings():
            raise UsageError(f"'{name}' is no readings file of this case; put it beside {self.plan.name}")
        return self.plan.parent / name


def _is_file(path: Path) -> bool:
    """Whether a file is there; in a folder that is closed none is known."""
    try:
        return path.is_file()
    except OSError:
        return False


def _begins_as_readings(file: Path) -> bool:
    """Whether a file seems to hold readings by what it begins with; it is looked at again once it has changed."""
    try:
        status = file.stat()
        return _seems_readings(file, status.st_mtime_ns, status.st_size)
    except OSError:
        return True  # who chooses it is told why it cannot be read


@lru_cache(maxsize=4096)
def _seems_readings(file: Path, changed_ns: int, size: int) -> bool:
    from ronnaplan.documents.plan_exchange import CONTACTS_HEADER
    from ronnaplan.tracking.readers import BEGINNING_BYTES, may_hold_readings

    with file.open("rb") as stream:
        beginning = stream.read(BEGINNING_BYTES)
    is_plan_s = beginning.startswith(",".join(CONTACTS_HEADER).encode())  # the contacts of its electrodes
    return not is_plan_s and may_hold_readings(file.name, beginning)
