"""Rigid transforms as arrays: how they are made, turned round and applied, and how small errors pass through them.

A matrix ``a_from_b`` (4, 4), in mm, maps coordinates of frame B into frame A. ``xi`` is a small movement, (rotation
vector in rad, translation in mm), by the convention of `ronnaplan.pose`.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray, unit


def orthonormality_excess(rotation: FloatArray) -> float:
    """Return the largest entry of ``R @ R.T - 1`` of ``rotation`` (3, 3): none for a rotation or a mirror image."""
    return float(np.abs(rotation @ rotation.T - np.eye(3)).max())


def nearest_rotations(matrices: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) nearest to ``matrices`` (..., 3, 3) in least squares, never a reflection.

    By the singular value decomposition with the sign correction of Kabsch (1978, Acta Cryst. A34:827) and Umeyama
    (1991, IEEE PAMI 13:376).
    """
    u, _, vt = np.linalg.svd(matrices)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., np.newaxis]
    return np.asarray(u @ vt)


def rigid(rotation: FloatArray, translation_mm: FloatArray) -> FloatArray:
    """Return the homogeneous (..., 4, 4) of ``rotation`` (..., 3, 3) and ``translation_mm`` (..., 3)."""
    matrix = np.zeros((*rotation.shape[:-2], 4, 4))
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = translation_mm
    matrix[..., 3, 3] = 1.0
    return matrix


def frame_along(origin_mm: FloatArray, direction: FloatArray) -> FloatArray:
    """Return a frame (4, 4) at ``origin_mm`` (3,) whose z points along ``direction`` (3,)."""
    z = unit(direction)
    x = unit(np.cross(np.eye(3)[int(np.abs(z).argmin())], z))
    return rigid(np.column_stack([x, np.cross(z, x), z]), np.asarray(origin_mm, dtype=np.float64))


def invert(matrix: FloatArray) -> FloatArray:
    """Return the inverse of rigid ``matrix`` (..., 4, 4)."""
    back = matrix[..., :3, :3].swapaxes(-1, -2)
    return rigid(back, -(back @ matrix[..., :3, 3, None])[..., 0])


def transform_points(matrix: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Return ``points_mm`` (..., N, 3) mapped by rigid ``matrix`` (..., 4, 4)."""
    mapped: FloatArray = points_mm @ matrix[..., :3, :3].swapaxes(-1, -2) + matrix[..., None, :3, 3]
    return mapped


def cross_matrix(vectors: FloatArray) -> FloatArray:
    """Return ``[v]x`` (..., 3, 3), so that ``[v]x @ w = v x w``, for ``vectors`` (..., 3)."""
    matrix = np.zeros((*vectors.shape, 3))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def point_jacobian(points_mm: FloatArray) -> FloatArray:
    """Return d(point)/d(xi) (..., 3, 6) at mapped ``points_mm`` (..., 3)."""
    identity = np.broadcast_to(np.eye(3), (*points_mm.shape, 3))
    return np.concatenate([-cross_matrix(points_mm), identity], axis=-1)


def about(places_mm: FloatArray) -> FloatArray:
    """Return what makes of a ``xi`` about the origin the same movement's about ``places_mm`` (..., 3): (..., 6, 6)."""
    carry = np.zeros((*places_mm.shape[:-1], 6, 6))
    carry[..., :3, :3] = np.eye(3)
    carry[..., 3:, :] = point_jacobian(places_mm)
    return carry


def adjoint(matrix: FloatArray) -> FloatArray:
    """Return the (..., 6, 6) that carries ``xi`` of frame B's axes and origin into frame A by ``a_from_b``."""
    rotation = matrix[..., :3, :3]
    carry = np.zeros((*matrix.shape[:-2], 6, 6))
    carry[..., :3, :3] = rotation
    carry[..., 3:, 3:] = rotation
    carry[..., 3:, :3] = cross_matrix(matrix[..., :3, 3]) @ rotation
    return carry


def carried(matrix: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the covariance (6, 6) of a ``xi`` of frame B in frame A, by ``a_from_b`` (4, 4)."""
    carry = adjoint(matrix)
    return np.asarray(carry @ covariance @ carry.T)


def exponential(rotation_vectors: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) by ``rotation_vectors`` (..., 3) in rad (Rodrigues' formula)."""
    angle = np.linalg.norm(rotation_vectors, axis=-1)[..., None, None]
    K = cross_matrix(rotation_vectors)
    half = np.sinc(angle / (2 * np.pi))
    turned: FloatArray = np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * half**2 * (K @ K)
    return turned


def rotation_sd_deg(covariance: FloatArray) -> float:
    """Return the standard deviation of a pose's rotation about its most uncertain axis, of its covariance (6, 6)."""
    return float(np.degrees(np.sqrt(max(np.linalg.eigvalsh(covariance[:3, :3])[-1], 0.0))))
