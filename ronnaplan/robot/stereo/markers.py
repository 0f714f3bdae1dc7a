"""Markers re-localized by the cameras on the robot, and the registration of the scan to them.

The error of ``tcp_from_rig`` is common to all looks: it does not average out over the markers, so it is carried through
the fit as one error and not as one of each marker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ronnaplan.correspondence.told import LEAST_PAIRS
from ronnaplan.errors import InputError, RefusedError, check_type
from ronnaplan.geometry import FloatArray, Points, mutual_distances
from ronnaplan.pose import Pose
from ronnaplan.registration.marker_registration import MarkerRegistration, register_markers
from ronnaplan.registration.registration import Registration
from ronnaplan.robot.chain import TCP, R, to_frame
from ronnaplan.robot.stereo.camera import RIG, StereoRig
from ronnaplan.robot.stereo.disagreement import explanations, is_split
from ronnaplan.robot.stereo.images import ImagePair
from ronnaplan.robot.stereo.sphere import StereoSphere, locate_sphere
from ronnaplan.sigmas import LARGEST_STATED_MM, SIGMA_LAMP_DEG
from ronnaplan.transforms import point_jacobian, transform_points

SAME_SPHERE_MM = 1.0
"""Two looks at one sphere put it no further apart."""
SAME_PLACE = 30.0
"""Nor, squared and in their errors, by more than these explain: errors as stated do so once in a million times."""


@dataclass(frozen=True, eq=False)
class RobotMarkers:
    """Spheres (N) re-localized one after the other from robot poses (N), in the rig's coordinates at each."""

    labels: tuple[str, ...]
    in_rig_mm: FloatArray
    """(N, 3)."""
    own_mm2: FloatArray
    """Covariances (N, 3, 3) in R of the errors that each look has for itself: outlines, cameras, robot."""
    robot_from_tcp: FloatArray
    """(N, 4, 4)."""
    tcp_from_rig: Pose
    """Its error is common to all."""

    @property
    def positions_mm(self) -> FloatArray:
        """The spheres (N, 3) in R."""
        chained = self.robot_from_tcp @ self.tcp_from_rig.matrix
        return transform_points(chained, self.in_rig_mm[:, None])[:, 0]

    @property
    def common_jacobian(self) -> FloatArray:
        """What the error (6) of ``tcp_from_rig`` does to each sphere in R: (N, 3, 6)."""
        in_tcp = transform_points(self.tcp_from_rig.matrix, self.in_rig_mm)
        jacobian: FloatArray = self.robot_from_tcp[:, :3, :3] @ point_jacobian(in_tcp)
        return jacobian

    @property
    def points(self) -> Points:
        """The spheres in R, each with its whole error; those errors are not independent of each other."""
        jacobian = self.common_jacobian
        common = jacobian @ self.tcp_from_rig.covariance @ jacobian.transpose(0, 2, 1)
        return Points(self.positions_mm, self.own_mm2 + common, self.labels, R)


def in_rig(
    looks: dict[int, ImagePair],
    rig: StereoRig,
    *,
    diameter_mm: float,
    largest_mm: float = LARGEST_STATED_MM,
    lamp_sd_deg: float = SIGMA_LAMP_DEG,
) -> list[StereoSphere]:
    """Return the one sphere of ``diameter_mm`` of each look; what is refused names the look by its frame.

    Centers that are not known to ``largest_mm`` are refused; ``lamp_sd_deg`` is as in `locate_sphere`.
    """
    look = partial(locate_sphere, rig=rig, diameter_mm=diameter_mm, largest_mm=largest_mm, lamp_sd_deg=lamp_sd_deg)
    found = []
    for number, pair in looks.items():
        try:
            found.append(look(*pair))
        except (InputError, RefusedError) as error:
            raise type(error)(f"frame {number}: {error}") from error
    return found


def relocate(
    looks: dict[int, ImagePair],
    robot_from_tcp: Sequence[Pose],
    rig: StereoRig,
    *,
    diameter_mm: float,
    scatter_mm: float = 0.0,
    largest_mm: float = LARGEST_STATED_MM,
    lamp_sd_deg: float = SIGMA_LAMP_DEG,
) -> RobotMarkers:
    """Return the sphere of each look, labelled by its frame, taken from ``robot_from_tcp`` in the same order.

    ``scatter_mm`` is the scatter per axis that a resting sphere's places had in the rig's calibration: a look errs by
    no less, whatever its outlines say. Refuses as `in_rig` does, above ``largest_mm`` too.
    """
    check_type(looks, dict, "the looks", "give the two images of each by its number: {1: (left, right)}")
    check_type(robot_from_tcp, Sequence, "the robot's poses", "give one for each look")
    if len(looks) != len(robot_from_tcp):
        raise InputError(f"{len(looks)} looks came with {len(robot_from_tcp)} robot poses; expected one each")
    places, errors = [], []
    spheres = in_rig(looks, rig, diameter_mm=diameter_mm, largest_mm=largest_mm, lamp_sd_deg=lamp_sd_deg)
    for sphere, pose in zip(spheres, robot_from_tcp, strict=True):
        here = Points(sphere.position_mm[None], sphere.covariance_mm2[None], ("",), RIG)
        calibrated = Pose.exact(rig.tcp_from_rig.matrix, TCP, RIG)
        own = to_frame(pose @ calibrated, here).covariances_mm2[0]
        lacking = max(scatter_mm**2 - float(np.trace(own)) / 3, 0.0)
        places.append(sphere.position_mm)
        errors.append(own + lacking * np.eye(3))
    found = RobotMarkers(
        tuple(str(number) for number in looks),
        np.array(places),
        np.array(errors),
        np.array([pose.matrix for pose in robot_from_tcp]),
        rig.tcp_from_rig,
    )
    require_apart(found, diameter_mm)
    return found


def require_apart(found: RobotMarkers, diameter_mm: float) -> None:
    """Raise `RefusedError` where two spheres that are not one and the same overlap."""
    apart = mutual_distances(found.positions_mm)
    overlap = (apart > SAME_SPHERE_MM) & (apart < diameter_mm)
    if overlap.any():
        one, other = np.argwhere(overlap)[0]
        raise RefusedError(
            f"the spheres of frames {found.labels[one]} and {found.labels[other]} are {apart[one, other]:.1f} mm "
            f"apart, yet {diameter_mm:g} mm wide; check that the robot's poses are those of these looks"
        )


@dataclass(frozen=True, eq=False)
class RobotRegistration:
    """The scan registered to the re-localized markers."""

    robot_from_ct: Pose
    """With the common error in its covariance."""
    registration: Registration
    """The fit alone, for its residuals."""
    labels: tuple[tuple[str, str], ...]
    """(CT marker, sphere) of each pair."""
    notes: tuple[str, ...]
    """Why markers or spheres were left out, and which are in no pair."""


def register_robot_markers(
    ct: Points, spheres: RobotMarkers, *, expected: int | None = None, sigma_ct_mm: float
) -> RobotRegistration:
    """Pair the scan's markers with the spheres, in any order, and register R from CT.

    ``expected`` and ``sigma_ct_mm`` are as in `register_markers`. Of several looks at one sphere the best known counts.
    Raises `InputError` for fewer than three spheres, `RefusedError` where the pairing is not unique, or a movement
    between the looks, or another place of the cameras at the TCP, explains what the markers' errors do not.
    """
    check_type(spheres, RobotMarkers, "the robot's spheres", "relocate returns them")
    spheres, again = _one_look_each(spheres)
    if len(spheres.labels) < LEAST_PAIRS:
        raise InputError(
            f"{len(spheres.labels)} spheres were re-localized; a registration needs at least {LEAST_PAIRS}, look at "
            "more of them"
        )
    found = register_markers(ct, spheres.points, expected=expected, sigma_ct_mm=sigma_ct_mm)
    if found.registration is None:
        raise RefusedError(f"the scan's markers and the re-localized spheres: {found.pairing.reason}")
    i, j = found.pairing.pairs.T
    fit = found.registration
    explained = explanations(fit, j, spheres.labels, spheres.robot_from_tcp[j, :3, :3])
    if explained:
        raise RefusedError(
            f"the markers do not agree with the scan, but would if {', or if '.join(explained)}: fasten head and base "
            "and look at all markers again; if that tells the same, check what else is named (the cameras by robot "
            "stereo-calibrate), or state a larger error of the markers (--sigma-ct)"
        )
    if is_split(fit, left_out=bool(found.unpaired_ct and found.unpaired_ots)):
        raise RefusedError(
            f"{len(j)} markers contradict each other by more than errors as stated explain (fit probability "
            f"{fit.fit_probability:.2g}), and so few do not tell which of them to believe: see whether head, base or "
            "a marker is loose and look at all again, at five or more, or state a larger error of them (--sigma-ct)"
        )
    each = fit.gain @ spheres.common_jacobian[j]
    common = spheres.tcp_from_rig.covariance
    counted = (each @ common @ each.transpose(0, 2, 1)).sum(axis=0)  # in the fit, as if of each marker for itself
    whole = each.sum(axis=0)
    covariance = fit.pose.covariance - counted + whole @ common @ whole.T
    pose = Pose(fit.transform, (covariance + covariance.T) / 2, R, ct.frame)
    pairs = tuple((ct.labels[a], spheres.labels[b]) for a, b in zip(i.tolist(), j.tolist(), strict=True))
    return RobotRegistration(pose, fit, pairs, (*again, *found.notes, *_alone(found)))


def _one_look_each(spheres: RobotMarkers) -> tuple[RobotMarkers, tuple[str, ...]]:
    """Return the spheres without looks that show one again, and what is told of these; side by side neither pairs.

    Looks that contradict each other are left as they are. An error of the rig parts two looks that are turned.
    """
    places, own, labels = spheres.positions_mm, spheres.own_mm2, spheres.labels
    jacobian, common = spheres.common_jacobian, spheres.tcp_from_rig.covariance
    kept: list[int] = []
    notes = []
    for n in np.argsort(np.trace(own, axis1=1, axis2=2), kind="stable").tolist():
        off = places[n] - places[kept]
        away = np.linalg.norm(off, axis=1)
        turned = jacobian[n] - jacobian[kept]
        apart = own[n] + own[kept] + turned @ common @ turned.transpose(0, 2, 1)
        squared = np.einsum("ki,kij,kj->k", off, np.linalg.inv(apart), off)
        same = np.flatnonzero((away <= SAME_SPHERE_MM) & (squared <= SAME_PLACE))
        kept += [] if len(same) else [n]
        notes += [
            f"frames {labels[kept[k]]} and {labels[n]} show one sphere, {away[k]:.3f} mm apart: frame "
            f"{labels[kept[k]]}, which tells it better, counts"
            for k in same[:1].tolist()
        ]
    kept.sort()
    once = replace(
        spheres,
        labels=tuple(labels[n] for n in kept),
        in_rig_mm=spheres.in_rig_mm[kept],
        own_mm2=spheres.own_mm2[kept],
        robot_from_tcp=spheres.robot_from_tcp[kept],
    )
    return once, tuple(notes)


def _alone(found: MarkerRegistration) -> tuple[str, ...]:
    sides = (("CT markers", found.unpaired_ct), ("spheres", found.unpaired_ots))
    return tuple(f"{what} without a partner: {', '.join(labels)}" for what, labels in sides if labels)
