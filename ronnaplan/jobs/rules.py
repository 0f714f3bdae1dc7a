"""Rules: what is looked for in which scan, where the first that fits a series decides; and what that may take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from ronnaplan.documents.fields import DocumentModel, Label, Line, PositiveMm, told_by_reader
from ronnaplan.localization import Build


def _build(text: str) -> str:
    with told_by_reader():
        Build.parse(text)
    return text


def _diameters(given: Any) -> Any:
    """Refuse several whole numbers, as the command line does: a comma between them may be a decimal one."""
    if isinstance(given, list) and len(given) > 1 and all(type(one) is int for one in given):
        raise ValueError(
            f"{given} may be {given[0]}.{given[1]} mm or {len(given)} diameters; write a point, or for several "
            f"{[float(one) for one in given]}"
        )
    # strict validation takes no list that it did not parse itself
    return tuple(given) if isinstance(given, list) else given


Seconds = Annotated[float, Field(gt=0, le=86_400)]


class JobLimits(DocumentModel):
    """What the work on one series may take."""

    seconds: Seconds = 600.0
    memory_mib: Annotated[int, Field(ge=256, le=1_000_000)] = 4096


class ScanRule(DocumentModel):
    """What is looked for in a series that all patterns fit (``*`` and ``?`` as in file names, any case)."""

    patterns: ClassVar[tuple[str, ...]] = ("station", "description", "protocol", "modality")
    """The fields that are patterns; each stands for the text of that name about a series."""

    name: Label
    station: Line = "*"
    description: Line = "*"
    protocol: Line = "*"
    modality: Line = "CT"
    diameters: Annotated[tuple[PositiveMm, ...], BeforeValidator(_diameters)] = ()
    """Of the markers in mm; none: found by itself, all of one size."""
    marker: Annotated[Line, AfterValidator(_build)] = "solid"
    expected: Annotated[int, Field(ge=1, le=1000)] | None = None
    template: Line | None = None

    @model_validator(mode="after")
    def _check_walls(self) -> Self:
        with told_by_reader():
            for diameter_mm in self.diameters:
                Build.parse(self.marker).require_hollow(diameter_mm)
        return self

    def fits(self, texts: Mapping[str, str]) -> bool:
        """Whether all patterns fit the texts about a series."""
        return all(_fits(getattr(self, name), texts[name]) for name in self.patterns)

    def covers(self, other: Self) -> bool:
        """Whether all that ``other`` fits is plainly fitted by this one, too."""
        return all(_covers(getattr(self, name), getattr(other, name)) for name in self.patterns)


def _fits(pattern: str, told: str) -> bool:
    return fnmatchcase(told.casefold(), pattern.casefold().replace("[", "[[]"))  # brackets stand for themselves


def _covers(pattern: str, other: str) -> bool:
    """Whether one pattern fits the other as a text, of which a ``?`` would take a ``*`` for one character."""
    return pattern.casefold() == other.casefold() or ("?" not in pattern and _fits(pattern, other))


AnyRule = TypeVar("AnyRule", bound=ScanRule)


def first_fitting(rules: Sequence[AnyRule], texts: Mapping[str, str]) -> AnyRule | None:
    """Return the first rule that fits the texts about a series, by the names of its patterns; None without one."""
    return next((rule for rule in rules if rule.fits(texts)), None)


def never_reached(rules: Sequence[AnyRule]) -> list[tuple[AnyRule, AnyRule]]:
    """Return the rules that no series goes by, each with an earlier one that fits all that it does."""
    earlier = ((rule, next((one for one in rules[:n] if one.covers(rule)), None)) for n, rule in enumerate(rules))
    return [(rule, first) for rule, first in earlier if first is not None]
