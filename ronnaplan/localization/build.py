"""How the markers are made: solid balls, hollow shells, or balls wrapped in something; and how true to size."""

from __future__ import annotations

from dataclasses import dataclass

from ronnaplan.errors import UsageError, check_type
from ronnaplan.text import plain_number

KINDS = {"shell": -1.0, "wrapped": 1.0}
"""What may be said beside 'solid', and on which side of the surface its layer lies."""

SIZE_TOLERANCE_MM = 0.06
"""A fitted diameter that is off by no more than this is the stated one: kernels that are not Gaussian make 0.04 mm."""


@dataclass(frozen=True)
class Build:
    """A second ball about the marker's own center, larger in radius by ``layer_mm``: below 0 a cavity, 0 none."""

    layer_mm: float = 0.0

    @property
    def wall_mm(self) -> float:
        """Thickness of a hollow marker's shell; 0 where it is not hollow."""
        return max(-self.layer_mm, 0.0)

    @classmethod
    def parse(cls, text: str) -> Build:
        """Read 'solid', 'shell:WALL' or 'wrapped:THICKNESS' (mm); raises `UsageError` for anything else."""
        check_type(text, str, "the marker", "write 'solid', 'shell:WALL' or 'wrapped:THICKNESS', in mm")
        kind, _, number = text.partition(":")
        if text == "solid":
            return cls()
        layer_mm = plain_number(number)
        if kind not in KINDS or layer_mm is None or layer_mm <= 0:
            raise UsageError(f"the marker is '{text}'; expected solid, shell:WALL or wrapped:THICKNESS in mm")
        return cls(KINDS[kind] * layer_mm)

    def require_hollow(self, diameter_mm: float) -> None:
        """Raise `UsageError` where a marker of this diameter has no room for its wall."""
        if self.wall_mm >= diameter_mm / 2:
            raise UsageError(
                f"the wall of {self.wall_mm:g} mm leaves nothing hollow in a marker of {diameter_mm:g} mm; check both, "
                "or say 'solid'"
            )


SOLID = Build()


def is_off_size(excess_mm: float) -> bool:
    """Whether a diameter that is off by ``excess_mm`` says that something is not as stated."""
    return abs(excess_mm) > SIZE_TOLERANCE_MM
