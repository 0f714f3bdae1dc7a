"""Many registrations at once, for studies, bootstraps and tracking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.bounds import FARTHEST_POINT_MM
from ronnaplan.errors import InputError, UsageError
from ronnaplan.geometry import FloatArray, as_numbers
from ronnaplan.registration.covariances import as_pair, combined_covariances, fitted_pose_covariance
from ronnaplan.rigid import fit_closed_form, fit_likelihood, fre_rms_mm, require_spread
from ronnaplan.text import counted

CHUNK = 2000
"""Likelihood fits done at a time, so that their arrays stay in the processor's cache."""


@dataclass(frozen=True, eq=False, repr=False)
class RegistrationBatch:
    """B registrations: ``transforms`` (B, 4, 4) and, if errors were stated, ``covariances`` (B, 6, 6)."""

    transforms: FloatArray
    covariances: FloatArray | None
    fre_rms_mm: FloatArray
    settled: NDArray[np.bool_]
    """Which fits (B,) converged; contradictory pairs may not."""

    def __repr__(self) -> str:
        unsettled = int((~self.settled).sum())
        doubt = f", {unsettled} not settled" if unsettled else ""
        count, median_mm = counted(len(self.transforms), "registration"), float(np.median(self.fre_rms_mm))
        return f"RegistrationBatch({count}, FRE {median_mm:.3g} mm in the median{doubt})"


def register_batch(
    moving: ArrayLike, fixed: ArrayLike, covariances: tuple[ArrayLike | None, ArrayLike | None] | None = None
) -> RegistrationBatch:
    """Register each of B point sets ``moving`` (B, N, 3) onto its ``fixed`` (B, N, 3), as `register_points` does.

    ``covariances``: those of moving and fixed points, each (3, 3), (N, 3, 3) or (B, N, 3, 3), in mm^2, or None for
    exact ones. Raises `InputError` as `register_points` does, but for pairs that are given twice: a bootstrap has them.
    """
    moving_mm, fixed_mm = (as_numbers(side, "the batches", "(B, N, 3) twice, in mm") for side in (moving, fixed))
    if moving_mm.ndim != 3 or len(moving_mm) == 0 or moving_mm.shape[-1] != 3 or moving_mm.shape != fixed_mm.shape:
        raise InputError(f"batches have shapes {moving_mm.shape} and {fixed_mm.shape}; expected (B, N, 3) twice")
    if not all((np.abs(side) <= FARTHEST_POINT_MM).all() for side in (moving_mm, fixed_mm)):
        raise InputError(
            f"a batch holds coordinates that are not finite, or beyond {FARTHEST_POINT_MM:g} mm; leave those "
            "registrations out, or convert the coordinates to millimetres"
        )
    require_spread(moving_mm, "moving points")
    require_spread(fixed_mm, "fixed points")
    if covariances is not None and not (isinstance(covariances, tuple) and len(covariances) == 2):
        raise UsageError("the covariances of a batch are no tuple of two; expected (moving, fixed), in mm^2")
    sides = as_pair(covariances, moving_mm.shape[:2])
    if sides is None:
        matrices = fit_closed_form(moving_mm, fixed_mm)
        spread, settled = None, np.ones(len(matrices), dtype=bool)
    else:
        parts = [slice(start, start + CHUNK) for start in range(0, len(moving_mm), CHUNK)]
        fitted = [_fit(moving_mm[p], fixed_mm[p], sides[0][p], sides[1][p]) for p in parts]
        matrices, spread = (np.concatenate([part[k] for part in fitted]) for k in (0, 1))
        settled = np.concatenate([part[2] for part in fitted])
    return RegistrationBatch(matrices, spread, fre_rms_mm(matrices, moving_mm, fixed_mm), settled)


def _fit(
    moving_mm: FloatArray, fixed_mm: FloatArray, moving_mm2: FloatArray, fixed_mm2: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    matrices, settled = fit_likelihood(moving_mm, fixed_mm, moving_mm2, fixed_mm2)
    combined = combined_covariances(matrices, moving_mm2, fixed_mm2)
    spread = fitted_pose_covariance(matrices, moving_mm, fixed_mm, combined, (moving_mm2, fixed_mm2))
    return matrices, spread, settled
