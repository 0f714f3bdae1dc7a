"""From the markers of a scan and a tracker's readings to the registration: pair and fit, or refuse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ronnaplan.correspondence import Pairing
from ronnaplan.errors import FrameMismatchError, UsageError, check_type
from ronnaplan.geometry import Points, require_sigma
from ronnaplan.registration.registration import Registration, register_points
from ronnaplan.sigmas import SIGMA_CT_MM


@dataclass(frozen=True, eq=False)
class MarkerRegistration:
    """The pairing of CT markers with readings and, where it is unique, the registration ``ots_from_ct``."""

    ct: Points
    """The scan's markers, with ``sigma_ct_mm`` in their covariances."""
    ots: Points
    pairing: Pairing
    registration: Registration | None
    """None when the pairing was refused."""
    sigma_ct_mm: float
    """Standard deviation per axis that was added to every CT marker's own covariance."""
    expected: int | None = None
    """The number of markers that both should hold, if it was told."""

    def __repr__(self) -> str:
        return f"MarkerRegistration({self.pairing!r}, {self.registration!r})"

    @property
    def unpaired_ct(self) -> tuple[str, ...]:
        """Labels of the CT markers that no reading belongs to."""
        paired = {int(i) for i, _ in self.pairing.pairs}
        return tuple(label for i, label in enumerate(self.ct.labels) if i not in paired)

    @property
    def unpaired_ots(self) -> tuple[str, ...]:
        """Labels of the readings that belong to no CT marker."""
        paired = {int(j) for _, j in self.pairing.pairs}
        return tuple(label for j, label in enumerate(self.ots.labels) if j not in paired)

    @property
    def notes(self) -> tuple[str, ...]:
        """Why markers were left out, and by how much the scan would have to be longer for the others to agree.

        Where fewer pair than are expected, how many: a marker that neither set holds is left out by nobody.
        """
        moved, doubtful = (
            [(self.ct.labels[i], self.ots.labels[j]) for i, j in pairs]
            for pairs in (self.pairing.moved, self.pairing.doubtful)
        )
        few = self.expected is not None and 0 < len(self.pairing.pairs) < self.expected
        return (
            *((f"{len(self.pairing.pairs)} markers pair where {self.expected} are expected",) if few else ()),
            *(
                f"marker {ct} and reading {ots} were left out: they lie side by side, as if the marker had moved"
                for ct, ots in moved
            ),
            *(
                f"marker {ct} and reading {ots} were left out: they fit, but not certainly enough"
                for ct, ots in doubtful
                if (ct, ots) not in moved
            ),
            *_told_stretch(self.registration),
        )

    @property
    def sigma_ots_mm(self) -> float | None:
        """Standard deviation per axis of the paired readings (root mean square), None where the pairing was refused."""
        if self.registration is None:
            return None
        paired = self.ots.covariances_mm2[[int(j) for _, j in self.pairing.pairs]]
        return float(np.sqrt(np.trace(paired, axis1=1, axis2=2).mean() / 3))


def register_markers(
    ct: Points,
    ots: Points,
    *,
    expected: int | None = None,
    at_least: int | None = None,
    sigma_ct_mm: float = SIGMA_CT_MM,
    known_pairs: tuple[tuple[str, str], ...] = (),
) -> MarkerRegistration:
    """Pair the markers of a scan ``ct`` with the tracker's ``ots``, in any order, and register ``ots_from_ct``.

    ``sigma_ct_mm`` (see `SIGMA_CT_MM`) is added to every CT marker's own covariance. ``known_pairs`` are labels
    (CT, OTS) that a person pointed at; ``expected`` and ``at_least`` are as in `match_points`. A refused pairing
    is returned, too, without a registration. Raises `UsageError` for labels that are not there, named twice, or those
    of several markers, `FrameMismatchError` for sets that have changed places, and `InputError` for what `match_points`
    or `register_points` cannot use.
    """
    from ronnaplan.correspondence import match_points

    _require_sides(ct, ots)
    require_sigma(sigma_ct_mm, "the CT error")
    known = _known(known_pairs, ct, ots)
    ct = Points(ct.positions_mm, ct.covariances_mm2 + sigma_ct_mm**2 * np.eye(3), ct.labels, ct.frame)
    pairing = match_points(
        ct.positions_mm,
        ots.positions_mm,
        expected,
        at_least=at_least,
        covariances_ct_mm2=ct.covariances_mm2,
        covariances_ots_mm2=ots.covariances_mm2,
        known_pairs=known,
    )
    if pairing.status != "unique":
        return MarkerRegistration(ct, ots, pairing, None, sigma_ct_mm, expected)
    i, j = pairing.pairs.T
    registration = register_points(
        ct.positions_mm[i],
        ots.positions_mm[j],
        (ct.covariances_mm2[i], ots.covariances_mm2[j]),
        labels=[ct.labels[k] for k in i],
        moving_frame=ct.frame,
        fixed_frame=ots.frame,
    )
    return MarkerRegistration(ct, ots, pairing, registration, sigma_ct_mm, expected)


def _told_stretch(registration: Registration | None) -> tuple[str, ...]:
    if registration is None or registration.stretch is None:
        return ()
    told = ", ".join(f"{100 * share:+.1f} %" for share in registration.stretch)
    return (f"the readings would fit a scan that is longer by {told} along x, y and z",)


def _require_sides(ct: Points, ots: Points) -> None:
    """Raise an error unless both are points, and the scan's come first: else their errors would change sides."""
    for points, what in ((ct, "the scan's markers"), (ots, "the tracker's markers")):
        check_type(
            points, Points, what, "give the points of what localize, or find_markers, returned: found.points"
        )
    if (ct.frame.name, ots.frame.name) == ("OTS", "CT"):
        raise FrameMismatchError(
            "the scan's markers are of frame OTS and the tracker's of CT; expected the scan's first, then the tracker's"
        )


def _known(pairs: Sequence[tuple[str, str]], ct: Points, ots: Points) -> list[tuple[int, int]]:
    """Return the rows of ``pairs`` of labels (CT, tracker); raises `UsageError` for what names no markers, or twice."""
    if not all(isinstance(pair, Sequence) and len(pair) == 2 for pair in pairs):
        raise UsageError(f"known pairs are {pairs!r}; expected pairs of (CT label, tracker label)")
    for side in zip(*pairs, strict=True):
        if len(set(side)) < len(side):
            raise UsageError(f"known pairs name the markers {', '.join(side)}; expected each once")
    return [(_index(ct, a, "CT"), _index(ots, b, "tracker")) for a, b in pairs]


def _index(points: Points, label: str, kind: str) -> int:
    if label not in points.labels:
        raise UsageError(f"there is no {kind} marker {label}; there are {', '.join(points.labels)}")
    if points.labels.count(label) > 1:
        raise UsageError(f"several {kind} markers are named {label}; expected one, so name them apart")
    return points.labels.index(label)
