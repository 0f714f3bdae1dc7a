"""A phantom whose markers' places are known, found in a scan: how far off its markers are, and whether that is stated.

The phantom is paired with the markers found, whatever its place, and fitted rigidly. What that leaves over is judged
against the stated covariances; then the scan may also be stretched and sheared, as a wrong pixel size, table feed or
gantry tilt makes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ronnaplan.correspondence import Pairing, match_points
from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray, Points, as_points
from ronnaplan.registration.beside_a_pose import fitted_beside
from ronnaplan.registration.registration import Registration, register_points
from ronnaplan.transforms import point_jacobian, transform_points

CONFIDENCE = 0.95
"""Of every interval that is stated, and of the ellipsoids that markers are counted in."""

LEAST_MARKERS = 4
"""Three markers fit any scan well; the fourth one tells."""

LARGEST_STRETCH = 0.0005
"""A stretch or shear of the scan below this displaces nothing by more than 0.05 mm at 100 mm."""

SURE = 0.999
"""A stretch is called one when scatter as seen makes less of it with this probability."""

TELLING_STRETCH = 0.002
"""Stretches with a larger standard error are not stated: the phantom does not tell them."""

WIDEST_STRETCH = 0.01
"""Standard deviation of stretches before anything is known of them; no scanner in use is off by more."""

PHANTOM_ERROR_MM = 1e-6
"""What stands for no error at all of the phantom's own places: covariances are definite."""

STRETCHES = ("in_plane", "along", "shear_u", "shear_v")
"""What may be wrong with a scan's geometry: pixel size, table feed, and slices that slide along u and v."""


@dataclass(frozen=True, eq=False)
class KnownPhantom:
    """Markers ``centers_mm`` (N, 3), known up to ``covariances_mm2`` (N, 3, 3), in any frame of their own.

    ``has_hand`` is False where only distances are known, which do not tell a phantom from its mirror image.
    ``scan`` names the scan in which the markers were found (`names_of_scan`); empty where their places come from none.
    """

    name: str
    labels: tuple[str, ...]
    centers_mm: FloatArray
    covariances_mm2: FloatArray
    has_hand: bool = True
    scan: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls,
        name: str,
        labels: Sequence[str],
        centers_mm: FloatArray,
        sigma_mm: float = 0.0,
        *,
        has_hand: bool = True,
        scan: frozenset[str] = frozenset(),
    ) -> KnownPhantom:
        """Return a phantom whose places (N, 3) are right within ``sigma_mm`` an axis."""
        centers = as_points(centers_mm, "the phantom's markers")
        covariances = np.tile(max(sigma_mm, PHANTOM_ERROR_MM) ** 2 * np.eye(3), (len(centers), 1, 1))
        return cls(name, tuple(labels), centers, covariances, has_hand, scan)

    @property
    def mirrored(self) -> KnownPhantom:
        """The mirror image."""
        return replace(self, centers_mm=-self.centers_mm)


@dataclass(frozen=True)
class Stretch:
    """One of `STRETCHES`: its share of a length, and the share's standard error, from the scatter if that is larger."""

    name: str
    share: float
    standard_error: float
    is_sure: bool
    """Whether it stands out from the scatter."""


@dataclass(frozen=True, eq=False)
class PhantomCheck:
    """A phantom paired and fitted: ``registration`` maps it into the scan, whose slice axes u, v, w are ``axes``."""

    phantom: KnownPhantom
    registration: Registration
    axes: FloatArray
    missing: tuple[str, ...]
    """The phantom's markers that were not found."""
    strange: tuple[str, ...]
    """Markers found that are not the phantom's."""

    @property
    def errors_mm(self) -> FloatArray:
        """Found minus true center (N, 3) along u, v, w, as far as a rigid fit leaves it."""
        errors: FloatArray = self.registration.residual_vectors_mm @ self.axes.T
        return errors

    @property
    def hidden_share(self) -> float:
        """What is seen of the errors after the fit, as a share of their size: it takes six figures out of 3 N."""
        return float(np.sqrt(self.registration.degrees_of_freedom / (3 * len(self.registration))))

    @property
    def in_slices_rms_mm(self) -> float:
        """Root mean square error per axis within the slices, with what the fit hides added."""
        return float(np.sqrt(np.mean(self.errors_mm[:, :2] ** 2))) / self.hidden_share

    @property
    def across_rms_mm(self) -> float:
        """Root mean square error across the slices, with what the fit hides added."""
        return float(np.sqrt(np.mean(self.errors_mm[:, 2] ** 2))) / self.hidden_share

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """The scan's stretches that the phantom tells."""
        return self._stretched[0]

    @property
    def worst_stretches(self) -> tuple[Stretch, ...]:
        """Those that are sure and not negligible."""
        return tuple(one for one in self.stretches if one.is_sure and abs(one.share) > LARGEST_STRETCH)

    @property
    def judged(self) -> tuple[float, int]:
        """Chi-square of what is left over, and its degrees of freedom: without the stretches, where these are bad."""
        if self.worst_stretches:
            return self._stretched[1:]
        return self.registration.chi_square, self.registration.degrees_of_freedom

    @property
    def within(self) -> tuple[int, int]:
        """How many markers lie within the ellipsoid that is stated for what the fit leaves over, and of how many."""
        from scipy.special import chdtri

        fit = self.registration
        left_mm2 = fit.covariances_mm2 - fit.pose.point_covariances(fit.moving_mm)
        values, vectors = np.linalg.eigh(left_mm2)
        sizes = np.trace(fit.covariances_mm2, axis1=-2, axis2=-1)[:, np.newaxis]
        tells = values > 1e-6 * sizes  # what the fit takes out whole tells nothing
        along = np.einsum("nij,ni->nj", vectors, fit.residual_vectors_mm)
        squares = np.sum(np.where(tells, along**2 / np.where(tells, values, 1.0), 0.0), axis=1)
        limits = chdtri(np.maximum(tells.sum(axis=1), 1), 1.0 - CONFIDENCE)
        return int(np.sum(squares <= limits)), len(squares)

    @cached_property
    def _stretched(self) -> tuple[tuple[Stretch, ...], float, int]:
        """Fit pose and stretches together, by least squares weighted with the covariances."""
        from scipy.special import stdtrit

        fit = self.registration
        mapped = transform_points(fit.transform, fit.moving_mm)
        moves = _stretch_moves(mapped, self.axes)
        found = fitted_beside(
            fit.residual_vectors_mm, fit.covariances_mm2, point_jacobian(mapped), moves, WIDEST_STRETCH
        )
        scatter = max(found.chi_square / found.freedom, 1.0)  # of two freedoms and more, with `LEAST_MARKERS`
        errors = np.sqrt(found.variances * scatter)
        limit = float(stdtrit(found.freedom, 0.5 + SURE / 2.0))
        told = tuple(
            Stretch(name, float(share), float(error), bool(abs(share) > limit * error))
            for name, share, error in zip(STRETCHES, found.unknowns, errors, strict=True)
            if error < TELLING_STRETCH
        )
        return told, found.chi_square, found.freedom


def names_of_scan(voxel_sha256: str | None, series_uid: str | None) -> frozenset[str]:
    """Return what names a scan: its voxels, and its series, of which a part or a copy has others."""
    return frozenset(name for name in (voxel_sha256, series_uid) if name)


def check_phantom(
    phantom: KnownPhantom, found: Points, axes: FloatArray, scan: frozenset[str] = frozenset()
) -> PhantomCheck:
    """Pair ``phantom`` with the markers ``found`` in a scan with the slice axes ``axes`` (3, 3), and fit it rigidly.

    ``scan`` names the scan (`names_of_scan`). Raises `InputError` where the phantom is known from that very scan, or
    has fewer than `LEAST_MARKERS` markers; `RefusedError` where the scan shows fewer, or they do not pair in exactly
    one way.
    """
    if scan & phantom.scan:
        raise InputError(
            f"the truth '{phantom.name}' was found in this very scan, or in a part or copy of its series, which would "
            "be compared with itself; give a template, or the markers of another scan"
        )
    needed = f"a check needs {LEAST_MARKERS} or more"
    if len(phantom.labels) < LEAST_MARKERS:
        raise InputError(f"phantom '{phantom.name}' has {len(phantom.labels)} markers; {needed}")
    if len(found) < LEAST_MARKERS:
        raise RefusedError(f"the scan shows {len(found)} markers; {needed}")
    one, pairs = _paired(phantom, found.positions_mm)
    if len(pairs) < LEAST_MARKERS:
        raise RefusedError(
            f"{len(pairs)} markers pair with phantom '{phantom.name}', {LEAST_MARKERS} or more expected; "
            "check the file and the scan"
        )
    known, seen = pairs[:, 0], pairs[:, 1]
    registration = register_points(
        one.centers_mm[known],
        found.positions_mm[seen],
        (one.covariances_mm2[known], found.covariances_mm2[seen]),
        labels=[one.labels[n] for n in known],
        fixed_frame=found.frame,
    )
    missing = tuple(label for n, label in enumerate(one.labels) if n not in known)
    strange = tuple(label for n, label in enumerate(found.labels) if n not in seen)
    return PhantomCheck(one, registration, axes, missing, strange)


def _paired(phantom: KnownPhantom, found_mm: FloatArray) -> tuple[KnownPhantom, NDArray[np.int64]]:
    """Return the phantom, or its mirror image where only that pairs better, and the one set of pairs (L, 2)."""
    hands = [phantom] if phantom.has_hand else [phantom, phantom.mirrored]
    answers = [(one, match_points(one.centers_mm, found_mm)) for one in hands]
    unique = [(one, answer) for one, answer in answers if answer.status == "unique"]
    if not unique:
        reason = answers[0][1].reason
        raise RefusedError(f"phantom '{phantom.name}' does not pair with the markers found: {reason}")
    if len(unique) == 2 and not np.array_equal(unique[0][1].pairs, unique[1][1].pairs):
        sizes = [len(answer.pairs) for _, answer in unique]
        if sizes[0] == sizes[1]:
            raise RefusedError(
                f"phantom '{phantom.name}' and its mirror image both pair with the markers found; "
                "state its coordinates instead of its distances"
            )
    one, answer = max(unique, key=lambda each: _merit(each[0], each[1], found_mm))
    return one, answer.pairs


def _merit(phantom: KnownPhantom, answer: Pairing, found_mm: FloatArray) -> tuple[int, float]:
    """Sort answers by how many pairs they have, then by how well these fit."""
    known, seen = answer.pairs.T
    return len(known), -register_points(phantom.centers_mm[known], found_mm[seen]).fre_rms_mm


def _stretch_moves(places_mm: FloatArray, axes: FloatArray) -> FloatArray:
    """How far each of `STRETCHES` moves the places (N, 3), about their middle, in LPS (N, 3, 4)."""
    u, v, w = ((places_mm - places_mm.mean(axis=0)) @ axes.T).T
    zero = np.zeros_like(u)
    along_axes = np.array([[u, zero, w, zero], [v, zero, zero, w], [zero, w, zero, zero]])
    moves: FloatArray = np.einsum("ai,apn->nip", axes, along_axes)
    return moves
