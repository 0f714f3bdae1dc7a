"""Many registrations at once, for studies, bootstraps and tracking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.errors import InputError, UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import transform_points
from ronnaplan.registration.covariances import combined_covariances, fitted_pose_covariance
from ronnaplan.rigid import fit_closed_form, fit_likelihood, require_spread

CHUNK = 2000
"""Likelihood fits done at a time, so that their arrays stay in the processor's cache."""


@dataclass(frozen=True, eq=False)
class RegistrationBatch:
    """B registrations: ``transforms`` (B, 4, 4) and, if errors were stated, ``covariances`` (B, 6, 6)."""

    transforms: FloatArray
    covariances: FloatArray | None
    fre_rms_mm: FloatArray
    settled: NDArray[np.bool_]
    """Which fits (B,) converged; contradictory pairs may not."""


def register_batch(
    moving: ArrayLike, fixed: ArrayLike, covariances: tuple[ArrayLike, ArrayLike] | None = None
) -> RegistrationBatch:
    """Register each of B point sets ``moving`` (B, N, 3) onto its ``fixed`` (B, N, 3), as `register_points` does.

    ``covariances``: those of moving and fixed points, each (N, 3, 3) or (B, N, 3, 3), in mm^2.
    Raises `InputError` as `register_points` does.
    """
    try:
        moving_mm, fixed_mm = np.asarray(moving, dtype=np.float64), np.asarray(fixed, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("the batches are not made of numbers; expected (B, N, 3) twice, in mm") from error
    if moving_mm.ndim != 3 or len(moving_mm) == 0 or moving_mm.shape[-1] != 3 or moving_mm.shape != fixed_mm.shape:
        raise InputError(f"batches have shapes {moving_mm.shape} and {fixed_mm.shape}; expected (B, N, 3) twice")
    if not (np.isfinite(moving_mm).all() and np.isfinite(fixed_mm).all()):
        raise InputError("a batch holds coordinates that are not finite; leave those registrations out")
    require_spread(moving_mm, "moving points")
    require_spread(fixed_mm, "fixed points")
    if covariances is None:
        matrices = fit_closed_form(moving_mm, fixed_mm)
        spread, settled = None, np.ones(len(matrices), dtype=bool)
    else:
        if not isinstance(covariances, tuple) or len(covariances) != 2:
            raise UsageError("the covariances of a batch are no tuple of two; expected (moving, fixed), in mm^2")
        try:
            sides = [
                np.broadcast_to(np.asarray(side, dtype=np.float64), (*moving_mm.shape, 3)) for side in covariances
            ]
        except (TypeError, ValueError) as error:
            raise InputError(
                f"a batch's covariances do not fit its shape {moving_mm.shape}; "
                "expected (N, 3, 3) or (B, N, 3, 3) a side"
            ) from error
        if not np.isfinite(sides[0]).all() or np.linalg.eigvalsh(sides[0] + sides[1]).min() <= 0:
            raise InputError("a batch's covariances are not positive definite; expected (N, 3, 3) in mm^2 a side")
        parts = [slice(start, start + CHUNK) for start in range(0, len(moving_mm), CHUNK)]
        fitted = [_fit(moving_mm[p], fixed_mm[p], sides[0][p], sides[1][p]) for p in parts]
        matrices, spread = (np.concatenate([part[k] for part in fitted]) for k in (0, 1))
        settled = np.concatenate([part[2] for part in fitted])
    residual = fixed_mm - transform_points(matrices, moving_mm)
    fre = np.sqrt((residual**2).sum(axis=-1).mean(axis=-1))
    return RegistrationBatch(matrices, spread, fre, settled)


def _fit(
    moving_mm: FloatArray, fixed_mm: FloatArray, moving_mm2: FloatArray, fixed_mm2: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    matrices, settled = fit_likelihood(moving_mm, fixed_mm, moving_mm2, fixed_mm2)
    combined = combined_covariances(matrices, moving_mm2, fixed_mm2)
    spread = fitted_pose_covariance(matrices, moving_mm, fixed_mm, combined, (moving_mm2, fixed_mm2))
    return matrices, spread, settled
