"""How a result shows itself: in one line, as a table, as a picture, in a notebook."""

from __future__ import annotations

import base64
import html
import logging
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError
from ronnaplan.extras import library_of_arrays

if TYPE_CHECKING:
    from ronnaplan.figures import Head, Picture

LOG = logging.getLogger(__name__)

Item = TypeVar("Item")

DECIMALS = 4
"""Digits behind the point in a notebook's table; `to_dataframe` has them all."""


class Shown(Sequence[Item], Generic[Item]):
    """A sequence of results that shows itself; a room's class says of what, with what columns and in which picture."""

    def _items(self) -> Sequence[Item]:
        raise NotImplementedError

    def _columns(self) -> Mapping[str, Sequence[object]]:
        raise NotImplementedError

    def _headline(self) -> str:
        raise NotImplementedError

    def plot(self) -> Picture:
        """Return a picture of the result."""
        raise NotImplementedError

    def __len__(self) -> int:
        return len(self._items())

    def __iter__(self) -> Iterator[Item]:
        return iter(self._items())

    @overload
    def __getitem__(self, index: int) -> Item: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Item]: ...

    def __getitem__(self, index: int | slice) -> Item | Sequence[Item]:
        return self._items()[index]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._headline()})"

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame with a row for each item; raises `UsageError` where pandas is not installed."""
        return library_of_arrays("pandas").DataFrame(
            {name: list(values) for name, values in self._columns().items()}
        )

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the line, the table, the picture."""
        columns = self._columns()
        heading = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
        rows = "".join(
            "<tr>" + "".join(f"<td>{html.escape(_cell(value))}</td>" for value in row) + "</tr>"
            for row in zip(*columns.values(), strict=True)
        )
        picture = base64.b64encode(self.plot().png()).decode("ascii")
        return (
            f"<div><p><b>{html.escape(repr(self))}</b></p><table><thead><tr>{heading}</tr></thead>"
            f'<tbody>{rows}</tbody></table><img alt="" src="data:image/png;base64,{picture}"></div>'
        )


def head_in_3d(result: object, volume: object) -> Head | None:
    """Return the head in a scan with fiducials or a plan; None where pyvista is not installed or cannot draw.

    Who draws it rests on the rooms of both, which therefore do not know it: it is asked by name.
    """
    try:
        head: Head = import_module("ronnaplan.scene.results").head_with(result, volume)
    except InputError:  # its reason may name a library's path
        LOG.info("no head in 3-D: pyvista is not installed (the extra ronnaplan[scene]), or VTK cannot be loaded")
        return None
    return head


def coordinates(name: str, points_mm: ArrayLike) -> dict[str, list[float]]:
    """Return points (N, 3) as three columns, ``<name>x_mm`` to ``<name>z_mm``."""
    table = np.asarray(points_mm, dtype=np.float64).reshape(-1, 3)
    return {f"{name}{axis}_mm": table[:, number].tolist() for number, axis in enumerate("xyz")}


def _cell(value: object) -> str:
    return f"{value:.{DECIMALS}f}" if isinstance(value, float) else str(value)
