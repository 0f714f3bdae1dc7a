"""From a scan to its candidates, each fitted and judged by itself: the middle of the pipeline."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.progress import Progress, advancing
from ronnaplan.geometry import FloatArray, first_apart
from ronnaplan.localization.build import SOLID, Build, is_off_size
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.depth import margin_mm
from ronnaplan.localization.fit.descent import MAX_WANDER
from ronnaplan.localization.fit.neighbourhood import Neighbourhood, gather
from ronnaplan.localization.fit.parameters import CENTER, RADIUS, profile_fwhm_mm
from ronnaplan.localization.fit.refine import evenly_filled, fit_ball
from ronnaplan.localization.judge.accept import MIN_COVERAGE, failures
from ronnaplan.localization.judge.crossed import without_the_screw
from ronnaplan.localization.judge.edge import blur_mm2, shape_of
from ronnaplan.localization.judge.evidence import Evidence, Usual
from ronnaplan.localization.judge.motion import Movement
from ronnaplan.localization.judge.noise import noise_level
from ronnaplan.localization.judge.rim import without_the_rim
from ronnaplan.localization.judge.sunk import is_surely_attached
from ronnaplan.localization.judge.uncertainty import by_excess, cramer_rao_bound
from ronnaplan.localization.scanner.hardened import MadeGood, without_the_head
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanner.scattered import brought_to_rest
from ronnaplan.localization.scanner.summed import lost_to_summing_hu
from ronnaplan.localization.search.detect import detect
from ronnaplan.localization.search.look import surface_shares
from ronnaplan.localization.search.nearest import unseen_share
from ronnaplan.threads import in_threads, single_threaded_algebra

OF_THE_SHAPE = {"thickness", "coverage", "free", "roundness", "whole", "certainty"}
"""Tests that balls fail whose blur is not along the slices' axes; `free` where they lie on skin."""

SAME_PLACE = 0.5
"""Candidates nearer to each other than this share of the diameter are the same thing."""

LEAST_TOGETHER = 3
"""So many markers say together what none says alone."""

UNKNOWN: Final = np.full((3, 3), np.nan)
NOTHING_USUAL: Final = Usual()


@dataclass(frozen=True, kw_only=True)
class Examined:
    """A candidate that was fitted: where it was seen, the fit's result, and (test, reason) of each test it failed.

    ``stated_mm`` is the diameter that was looked for, ``thickness_mm`` the slices' nominal thickness there.

    Covariance and bound are `UNKNOWN` where it is no marker, or was looked at for its size alone. The voxels and
    derivatives of the fit are not kept: hundreds of them would outweigh the scan.
    """

    candidate_mm: FloatArray
    stated_mm: float
    thickness_mm: float
    center_mm: FloatArray
    covariance_mm2: FloatArray
    bound_mm2: FloatArray
    parameters: FloatArray
    coverage: float
    unseen: float
    misfit: float
    is_clipped: bool
    excess_mm: float
    """Fitted minus stated diameter; 0 where clipping hides it."""
    by_excess: FloatArray
    """What that may do to the center: covariance (3, 3) for each mm^2; of markers only."""
    is_covered: bool
    movement: Movement | None
    """How far its edges seem to have moved; of markers only."""
    blur_mm2: FloatArray
    """Covariance (3, 3) of its blur in LPS; of solid markers that are not clipped, and of such as failed tests of
    `OF_THE_SHAPE` only."""
    shape: FloatArray
    """Shape (3, 3) of the ellipsoid that it is, by `edge.shape_of`; of markers whose blur is told only."""
    failures: tuple[tuple[str, str], ...]

    @property
    def failed(self) -> set[str]:
        """Names of the tests it failed."""
        return {name for name, _ in self.failures}

    @property
    def is_marker(self) -> bool:
        """Whether every test was passed."""
        return not self.failures

    @property
    def diameter_mm(self) -> float:
        """Fitted diameter."""
        return float(2.0 * self.parameters[RADIUS])

    @property
    def is_off_size(self) -> bool:
        """Whether its diameter is not the stated one."""
        return is_off_size(self.excess_mm)

    @property
    def shows_its_shape(self) -> bool:
        """Whether the ellipsoid that it is was told, and nothing lies on it that makes it another one."""
        return not self.is_covered and bool(np.isfinite(self.shape).all())

    @property
    def profile_mm(self) -> float:
        """Full width at half maximum of the fitted slice profile."""
        return profile_fwhm_mm(self.parameters)


Examine = Callable[[Scan, Sequence[tuple[FloatArray, float]]], list[Examined]]
"""Fits and judges a ball at each place (3,) of a scan, for the diameter in mm that is wanted there."""


def examine(
    scan: Scan, diameters_mm: Sequence[float], build: Build = SOLID, progress: Progress = False
) -> list[Examined]:
    """Fit and judge every place of ``scan`` that may be a ball of one of ``diameters_mm``, strongest first of each."""
    seen = [places_for(scan, diameter, build) for diameter in diameters_mm]
    wanted = [(place, diameter) for diameter, places in zip(diameters_mm, seen, strict=True) for place in places]
    return examine_places(scan, wanted, build, progress)


def examine_places(
    scan: Scan, wanted: Sequence[tuple[FloatArray, float]], build: Build, progress: Progress = False
) -> list[Examined]:
    """Fit and judge a ball at every place (3,) for the diameter in mm that is ``wanted`` there."""
    # The fits release the interpreter's lock, and each is independent of the others: any order, same result.
    with single_threaded_algebra():
        fits = in_threads(lambda one: examine_place(scan, one[0], one[1], build), wanted)
        sizes = " and ".join(f"{diameter:g}" for diameter in dict.fromkeys(diameter for _, diameter in wanted))
        return list(advancing(fits, len(wanted), progress, f"fitting balls of {sizes} mm"))


def places_for(scan: Scan, diameter_mm: float, build: Build) -> list[FloatArray]:
    """Return the places (3,) of ``scan`` at which a ball of ``diameter_mm`` is worth a fit, strongest first."""
    seen = detect(scan.volume, diameter_mm)
    shares = surface_shares(scan.volume, seen, diameter_mm, build, scan.thickness_mm(seen), MIN_COVERAGE)
    seen = seen[shares >= MIN_COVERAGE]
    return list(seen[first_apart(seen, SAME_PLACE * diameter_mm)])


def distinct(accepted: Iterable[Examined]) -> list[Examined]:
    """One marker a place, the better fit of two, best fits first."""
    ordered = sorted(accepted, key=lambda one: one.misfit)
    kept: list[int] = []
    for n, same in enumerate(same_places(ordered, ordered)):
        if not same[kept].any():
            kept.append(n)
    return [ordered[n] for n in kept]


def markers_in(examined: Iterable[Examined]) -> list[Examined]:
    """One marker a place, of the stated size that is nearest to its own where it may be of several, best fits first."""
    markers = [one for one in examined if one.is_marker]
    off_mm, stated_mm = np.array([(abs(one.excess_mm), one.stated_mm) for one in markers]).reshape(-1, 2).T
    shows = np.array([not one.is_clipped for one in markers], dtype=np.bool_)
    nearer = (stated_mm != stated_mm[:, None]) & shows & (off_mm < off_mm[:, None])
    of_others = (nearer & same_places(markers, markers)).any(axis=1)
    return distinct(one for one, is_other in zip(markers, of_others, strict=True) if not is_other)


def same_places(ones: Sequence[Examined], others: Sequence[Examined]) -> NDArray[np.bool_]:
    """Which of ``ones`` are about the same ball as which of ``others`` (N, M); of both there may be thousands."""
    centers_mm = np.array([other.center_mm for other in others]).reshape(-1, 3)
    stated_mm = np.array([other.stated_mm for other in others])
    same = [
        np.linalg.norm(centers_mm - one.center_mm, axis=1) < SAME_PLACE * np.minimum(stated_mm, one.stated_mm)
        for one in ones
    ]
    return np.array(same, dtype=np.bool_).reshape(len(ones), len(others))


def fit_place(
    scan: Scan, center_mm: FloatArray, diameter_mm: float, build: Build = SOLID, made_good: MadeGood = MadeGood.ALL
) -> BallFit:
    """Fit a ball of about ``diameter_mm`` at a place (3,) of the scan.

    Edges between slices tell a place to half their distance only, and a plate behind a ball draws its votes aside:
    a fit that moves away no farther, or by no more than its radius to where it shows a sphere, starts anew there.
    ``made_good`` says how much of what a head does to its image is.
    """
    fit = _fit(scan, center_mm, diameter_mm, build, made_good)
    moved_mm, near_mm = float(np.linalg.norm(fit.theta[CENTER])), MAX_WANDER * diameter_mm / 2.0
    is_between = moved_mm <= near_mm + scan.gap_mm / 2.0 and scan.gap_mm > near_mm
    is_sphere = moved_mm <= diameter_mm / 2.0 and fit.verdict.round_share >= MIN_COVERAGE
    if moved_mm > near_mm and (is_between or is_sphere):
        fit = _fit(scan, fit.center_mm, diameter_mm, build, made_good)
    return fit


def _fit(scan: Scan, center_mm: FloatArray, diameter_mm: float, build: Build, made_good: MadeGood) -> BallFit:
    if scan.slant is not None:  # rays do not run in slices that were computed aslant
        made_good = MadeGood.NOTHING
    if made_good is MadeGood.NOTHING:
        return _fit_as_summed(scan, center_mm, diameter_mm, build, made_good)[0]
    # Each is handed over without a name here, so that none is held until the next is made.
    return without_the_rim(
        without_the_screw(
            scan.volume,
            without_the_head(scan.volume, *_fit_as_summed(scan, center_mm, diameter_mm, build, made_good)),
        ),
        diameter_mm,
    )


def _fit_as_summed(
    scan: Scan, center_mm: FloatArray, diameter_mm: float, build: Build, made_good: MadeGood
) -> tuple[BallFit, MadeGood]:
    """Fit a ball with what rays lose that were summed first made good; return it, and what is left to make good.

    Where no fit comes to rest, so is what scatter does. Nothing is left of what surely is no ball.
    """
    reach_mm = 0.625 * diameter_mm + max(build.layer_mm, 0.0) + margin_mm(scan.widest_mm)
    around = gather(scan.volume, center_mm, reach_mm, scan.axes, scan.ceiling_hu)
    thickness_mm = float(scan.thickness_mm(center_mm))

    def fitted(seen: Neighbourhood) -> BallFit:
        fit = fit_ball(seen, diameter_mm, build, thickness_mm)
        return fit if scan.volume.grid.may_be_a_panels else evenly_filled(fit)

    fit = fitted(around)
    if made_good is MadeGood.ALL:
        fit = brought_to_rest(scan.volume, around, fit, fitted)
    if scan.summed.first and fit.converged and not fit.is_clipped:
        fit = fitted(fit.neighbourhood.given_back(lost_to_summing_hu(scan.volume, fit)))
        if made_good is MadeGood.ALL:
            made_good = MadeGood.BUT_ROWS  # all that rows add up was made good here
    return fit, MadeGood.NOTHING if is_surely_attached(scan.volume, fit) else made_good


def examine_place(
    scan: Scan,
    center_mm: FloatArray,
    diameter_mm: float,
    build: Build,
    usual: Usual = NOTHING_USUAL,
    *,
    for_its_size: bool = False,
) -> Examined:
    """Fit a ball of about ``diameter_mm`` at a place (3,) of the scan, and judge it by what is usual there.

    Of one that is looked at ``for_its_size`` alone nobody asks how certain its center is, which what a head does to its
    image moves; its size hardly changes with that.
    """
    fit = fit_place(scan, center_mm, diameter_mm, build, MadeGood.NOTHING if for_its_size else MadeGood.ALL)
    unseen = unseen_share(scan.volume, fit.center_mm, fit.diameter_mm / 2.0)
    thickness_mm = float(scan.thickness_mm(center_mm))
    gap_mm = scan.gap_across_mm(fit.center_mm, fit.diameter_mm / 2.0)
    noise_hu = noise_level(fit)
    evidence = Evidence(fit, diameter_mm, thickness_mm, gap_mm, noise_hu, unseen, scan.volume, usual)
    failed = tuple(failures(evidence, but={"certainty"} if for_its_size else frozenset()))
    is_center_told = not failed and not for_its_size
    # The two edges of a shell or a wrapping are too near each other.
    tells_blur = build == SOLID and not fit.is_clipped
    return Examined(
        candidate_mm=center_mm,
        stated_mm=diameter_mm,
        thickness_mm=thickness_mm,
        center_mm=fit.center_mm,
        covariance_mm2=evidence.covariance_mm2 if is_center_told else UNKNOWN,
        bound_mm2=cramer_rao_bound(fit, evidence.noise_hu) if is_center_told else UNKNOWN,
        parameters=fit.theta,
        coverage=fit.coverage,
        unseen=unseen,
        misfit=fit.misfit,
        is_clipped=fit.is_clipped,
        excess_mm=evidence.excess_mm,
        by_excess=by_excess(fit) if is_center_told else UNKNOWN,
        is_covered=fit.verdict.is_covered,
        movement=evidence.movement if is_center_told else None,
        blur_mm2=blur_mm2(evidence.edge)
        if tells_blur and {name for name, _ in failed} <= OF_THE_SHAPE
        else UNKNOWN,
        shape=shape_of(evidence.edge, diameter_mm / 2.0) if tells_blur and is_center_told else UNKNOWN,
        failures=failed,
    )
