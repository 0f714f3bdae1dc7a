"""How others find spheres in CT: each recipe as its users are told to run it, on voxels of a plain axial stack."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray

ISOTROPIC_MM = 1.0
AIR_TO_PLASTIC_HU = -440.0


def blob_log(ct: CTVolume, diameter_mm: float) -> FloatArray:
    """scikit-image's Laplacian-of-Gaussian blobs on a 1 mm isotropic copy."""
    from skimage.feature import blob_log as find

    return _blobs(ct, diameter_mm, lambda image, sigma: find(image, sigma, sigma, 1, threshold=0.25))


def blob_dog(ct: CTVolume, diameter_mm: float) -> FloatArray:
    """scikit-image's difference-of-Gaussians blobs on a 1 mm isotropic copy."""
    from skimage.feature import blob_dog as find

    return _blobs(ct, diameter_mm, lambda image, sigma: find(image, 0.9 * sigma, 1.3 * sigma, threshold=0.12))


def circles(ct: CTVolume, diameter_mm: float) -> FloatArray:
    """OpenCV's Hough circles slice by slice, joined over the slices."""
    import cv2

    pixel_mm = ct.grid.row_spacing_mm
    places = []
    for k, picture in enumerate(ct.voxels_hu):
        grey = np.clip((picture.astype(np.float32) + 1000) / 1500 * 255, 0, 255).astype(np.uint8)
        radius = diameter_mm / 2 / pixel_mm
        seen = cv2.HoughCircles(
            grey, cv2.HOUGH_GRADIENT, 1, radius, param1=120, param2=12,
            minRadius=int(0.8 * radius), maxRadius=int(np.ceil(1.1 * radius)),
        )  # fmt: skip
        found = () if seen is None else seen.reshape(-1, 3)
        places += [(k, circle[1], circle[0]) for circle in found]
    if not places:
        return np.empty((0, 3))
    return _join(ct.grid.positions_mm(np.array(places, dtype=np.float64)), diameter_mm / 2)


def threshold_centroid(ct: CTVolume, diameter_mm: float) -> FloatArray:
    """Threshold, connected components of about the right volume, centroid: the recipe given to Slicer's users."""
    from scipy import ndimage

    labels, count = ndimage.label(ct.voxels_hu > AIR_TO_PLASTIC_HU)
    voxel_mm3 = ct.grid.row_spacing_mm * ct.grid.column_spacing_mm * float(np.median(ct.grid.spacings_mm))
    volumes = ndimage.sum_labels(np.ones_like(labels), labels, range(1, count + 1)) * voxel_mm3
    ball = np.pi / 6 * diameter_mm**3
    chosen = np.flatnonzero((volumes > 0.7 * ball) & (volumes < 1.4 * ball)) + 1
    weights = ct.voxels_hu.astype(np.float64) + 1000
    places = ndimage.center_of_mass(weights, labels, chosen) if len(chosen) else []
    return ct.grid.positions_mm(np.array(places, dtype=np.float64).reshape(-1, 3))


def trackpy_features(ct: CTVolume, diameter_mm: float) -> FloatArray:
    """Feature finding of trackpy in 3-D on a 1 mm isotropic copy."""
    import trackpy

    trackpy.quiet()
    image, origin = _isotropic(ct)
    odd = int(diameter_mm / ISOTROPIC_MM) // 2 * 2 + 1
    frame = trackpy.locate(np.clip(image + 1000, 0, 1600), odd, minmass=2e5, separation=odd, engine="python")
    found: FloatArray = frame[["x", "y", "z"]].to_numpy() * ISOTROPIC_MM + origin
    return found


def mesh_sphere_fit(ct: CTVolume, diameter_mm: float) -> FloatArray:
    """Marching-cubes surface, pieces of about the right size, algebraic sphere fit to each."""
    from scipy import sparse
    from skimage.measure import marching_cubes

    vertices, faces, _, _ = marching_cubes(ct.voxels_hu.astype(np.float32), AIR_TO_PLASTIC_HU)
    edges = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = sparse.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(vertices),) * 2)
    _, piece = sparse.csgraph.connected_components(graph, directed=False)
    points = ct.grid.positions_mm(vertices.astype(np.float64))
    centers = []
    for number in np.flatnonzero(np.bincount(piece) > 200):
        own = points[piece == number]
        if np.ptp(own, axis=0).max() > 1.6 * diameter_mm:
            continue
        solution = np.linalg.lstsq(np.column_stack([2 * own, np.ones(len(own))]), (own**2).sum(axis=1))[0]
        radius = np.sqrt(solution[3] + solution[:3] @ solution[:3])
        if abs(2 * radius - diameter_mm) < 0.1 * diameter_mm:
            centers.append(solution[:3])
    return np.array(centers).reshape(-1, 3)


def _blobs(
    ct: CTVolume, diameter_mm: float, find: Callable[[FloatArray, float], NDArray[np.float64]]
) -> FloatArray:
    image, origin = _isotropic(ct)
    scaled = np.clip((image + 1000) / 1100, 0, 1.5)
    found = find(scaled, diameter_mm / 2 / np.sqrt(3) / ISOTROPIC_MM)
    centers: FloatArray = found[:, 2::-1] * ISOTROPIC_MM + origin
    return centers


def _isotropic(ct: CTVolume) -> tuple[FloatArray, FloatArray]:
    """Resample a plain axial stack to cubes; returns the image (z, y, x) and the place of its first voxel."""
    from scipy.ndimage import zoom

    steps = (float(np.median(ct.grid.spacings_mm)), ct.grid.row_spacing_mm, ct.grid.column_spacing_mm)
    image = zoom(
        ct.voxels_hu.astype(np.float64),
        [step / ISOTROPIC_MM for step in steps],
        order=1,
        mode="grid-constant",
        grid_mode=True,
    )
    shift = np.array([(ISOTROPIC_MM - step) / 2 for step in steps[::-1]])
    return image, ct.grid.origins_mm[0] + shift


def _join(places_mm: FloatArray, reach_mm: float) -> FloatArray:
    """Mean places of groups of points that hang together; groups of fewer than three are chance."""
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    graph = cKDTree(places_mm).sparse_distance_matrix(cKDTree(places_mm), reach_mm / 2)
    count, group = connected_components(graph, directed=False)
    groups = [places_mm[group == number] for number in range(count)]
    return np.array([own.mean(axis=0) for own in groups if len(own) >= 3]).reshape(-1, 3)


PEERS: dict[str, Callable[[CTVolume, float], FloatArray]] = {
    "scikit-image blob_log": blob_log,
    "scikit-image blob_dog": blob_dog,
    "OpenCV circles by slice": circles,
    "threshold + centroid": threshold_centroid,
    "trackpy 3-D": trackpy_features,
    "mesh + sphere fit": mesh_sphere_fit,
}
