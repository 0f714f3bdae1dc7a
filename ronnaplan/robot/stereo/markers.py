"""Markers re-localized by the cameras on the robot, and the registration of the scan to them.

The error of ``tcp_from_rig`` is common to all looks: it does not average out over the markers, so it is carried through
the fit as one error and not as one of each marker.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ronnaplan.correspondence.told import LEAST_PAIRS
from ronnaplan.errors import InputError, RefusedError, check_type
from ronnaplan.geometry import FloatArray, Points
from ronnaplan.pose import Pose
from ronnaplan.registration.marker_registration import MarkerRegistration, register_markers
from ronnaplan.registration.registration import Registration
from ronnaplan.robot.chain import TCP, R, to_frame
from ronnaplan.robot.misread import misread_as
from ronnaplan.robot.stereo.again import apart, contradiction, require_apart, same
from ronnaplan.robot.stereo.camera import RIG, StereoRig
from ronnaplan.robot.stereo.disagreement import disagrees, explained_by_one, explanations, is_split
from ronnaplan.robot.stereo.images import ImagePair
from ronnaplan.robot.stereo.robot_markers import RobotMarkers
from ronnaplan.robot.stereo.sphere import StereoSphere, locate_sphere
from ronnaplan.sigmas import LARGEST_STATED_MM, MISFIT_PROBABILITY, SIGMA_LAMP_DEG

FEWEST_TO_EXPLAIN = 4
"""Of fewer spheres some fit by chance where the poses are read in another way."""


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
    no less, whatever its outlines say. Refuses as `in_rig` does, above ``largest_mm`` too, and poses that were misread
    where looks at one sphere tell it.
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
    between the looks, another place of the cameras at the TCP, or a mistake in how the robot's poses were read
    explains what the markers' errors do not.
    """
    check_type(spheres, RobotMarkers, "the robot's spheres", "relocate returns them")
    looks = spheres
    spheres, again = _one_look_each(looks)
    if len(spheres.labels) < LEAST_PAIRS:
        raise InputError(
            f"{len(spheres.labels)} spheres were re-localized; a registration needs at least {LEAST_PAIRS}, look at "
            "more of them"
        )
    found = register_markers(ct, spheres.points, expected=expected, sigma_ct_mm=sigma_ct_mm)
    fit = _require_agreement(found, spheres, looks, partial(_misread, ct, looks, expected, sigma_ct_mm))
    i, j = found.pairing.pairs.T
    each = fit.gain @ spheres.common_jacobian[j]
    common = spheres.tcp_from_rig.covariance
    counted = (each @ common @ each.transpose(0, 2, 1)).sum(axis=0)  # in the fit, as if of each marker for itself
    whole = each.sum(axis=0)
    covariance = fit.pose.covariance - counted + whole @ common @ whole.T
    pose = Pose(fit.transform, (covariance + covariance.T) / 2, R, ct.frame)
    pairs = tuple((ct.labels[a], spheres.labels[b]) for a, b in zip(i.tolist(), j.tolist(), strict=True))
    return RobotRegistration(pose, fit, pairs, (*again, *found.notes, *_alone(found)))


def _require_agreement(
    found: MarkerRegistration,
    spheres: RobotMarkers,
    looks: RobotMarkers,
    misread: Callable[[float], str | None],
) -> Registration:
    """Return the fit of ``spheres``, one of ``looks`` each; raises `RefusedError` where the scan does not agree.

    ``misread`` tells mistakes in the robot's poses by which all would, if likelier than what it is given.
    """
    fit = found.registration
    if fit is None:
        why = contradiction(looks)
        if mistakes := misread(MISFIT_PROBABILITY):
            why = f"they agree if in the robot's poses {mistakes}: turn these into matrices, and relocate, anew"
        reason = f"the scan's markers and the re-localized spheres: {found.pairing.reason}"
        raise RefusedError(reason if why is None else f"{reason}; {why}")
    j = found.pairing.pairs[:, 1]
    explained = explanations(fit, j, spheres.labels, spheres.robot_from_tcp[j, :3, :3])
    left_out = bool(found.unpaired_ct and found.unpaired_ots)
    if (left_out or disagrees(fit)) and (mistakes := misread(explained_by_one(fit))):
        explained.append(f"in the robot's poses {mistakes}")
    if explained:
        raise RefusedError(
            f"the markers do not agree with the scan, but would if {', or if '.join(explained)}: fasten head and base "
            "and look at all markers again; if that tells the same, check what else is named (the cameras by robot "
            "stereo-calibrate, poses by turning them into matrices anew), or state a larger error of the markers "
            "(--sigma-ct)"
        )
    if is_split(fit, left_out=left_out):
        raise RefusedError(
            f"{len(j)} markers contradict each other by more than errors as stated explain (fit probability "
            f"{fit.fit_probability:.2g}), and so few do not tell which of them to believe: see whether head, base or "
            "a marker is loose and look at all again, at five or more, or state a larger error of them (--sigma-ct)"
        )
    return fit


def _one_look_each(spheres: RobotMarkers) -> tuple[RobotMarkers, tuple[str, ...]]:
    """Return the spheres without looks that show one again, and what is told of these; side by side neither pairs.

    Looks that contradict each other are left as they are.
    """
    labels = spheres.labels
    away_mm, squared = apart(spheres)
    is_same = same(away_mm, squared)
    kept: list[int] = []
    notes = []
    for n in np.argsort(np.trace(spheres.own_mm2, axis1=1, axis2=2), kind="stable").tolist():
        shown = [k for k in kept if is_same[n, k]]
        kept += [] if shown else [n]
        notes += [
            f"frames {labels[k]} and {labels[n]} show one sphere, {away_mm[n, k]:.3f} mm apart: frame {labels[k]}, "
            "which tells it better, counts"
            for k in shown[:1]
        ]
    return spheres.only(sorted(kept)), tuple(notes)


def _misread(
    ct: Points, looks: RobotMarkers, expected: int | None, sigma_ct_mm: float, least: float
) -> str | None:
    """Say by which mistakes in the robot's poses all ``looks`` fit the scan, and likelier than ``least``, if any."""

    def agree(poses: FloatArray) -> bool:
        meant, _ = _one_look_each(looks.taken_from(poses))
        if len(meant.labels) < FEWEST_TO_EXPLAIN:
            return False
        found = register_markers(ct, meant.points, expected=expected, sigma_ct_mm=sigma_ct_mm)
        if found.registration is None or (found.unpaired_ct and found.unpaired_ots):
            return False
        chance = found.registration.fit_probability
        return chance is not None and chance > least

    return misread_as(looks.robot_from_tcp, agree)


def _alone(found: MarkerRegistration) -> tuple[str, ...]:
    sides = (("CT markers", found.unpaired_ct), ("spheres", found.unpaired_ots))
    return tuple(f"{what} without a partner: {', '.join(labels)}" for what, labels in sides if labels)
