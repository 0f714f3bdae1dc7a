"""``ronnaplan prepare``: compile now what would else be compiled at first use, some minutes of a processor."""

from __future__ import annotations

import argparse
import io
import signal
from collections.abc import Callable
from contextlib import redirect_stderr
from typing import TYPE_CHECKING

from ronnaplan.cli.output import tell

if TYPE_CHECKING:
    from ronnaplan.ct import CTVolume

HELP = "Compile now, once after installation, what would else be compiled at first use."
DIAMETER_MM = 11.5
MARKERS_MM = ((20.0, 20.0, 16.0), (70.0, 25.0, 28.0), (30.0, 72.0, 40.0), (62.0, 60.0, 60.0))
"""Diameter and places of the markers of a scan that is made for this; they lie apart as no other four do."""
NEARLY_A_SQUARE_MM = ((0.0, 0.0, 0.0), (60.0, 0.0, 0.0), (60.0, 61.0, 0.0), (0.0, 60.0, 5.0))
"""Markers of which one order fits nearly as well as another: only of such is it computed how often they are refused."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Take no arguments."""


def run(arguments: argparse.Namespace) -> int:
    """Do each of the `PARTS` in a process of its own, at once; refused where what they compile would be lost."""
    import multiprocessing

    from kernelcache import homeless
    from ronnaplan.errors import InputError
    from ronnaplan.localization import localize  # noqa: F401  # its kernels tell whether they can be kept

    if homeless:
        raise InputError(
            "what is compiled cannot be kept; name a folder that may be written to by NUMBA_CACHE_DIR"
        )
    tell("compiling the inner loops, once for this version and machine: some minutes of a processor ...")
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=compile_in, args=(part,), daemon=True) for part in PARTS]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    failed = [part for part, process in zip(PARTS, processes, strict=True) if process.exitcode]
    if failed:
        raise InputError(
            f"what compiles ended amid it ({', '.join(one.__name__ for one in failed)}); "
            "each takes up to 1 GB of memory: make room, and call `ronnaplan prepare` again, which goes on from there"
        )
    tell("done: localize, register, robot place and relocate start without compiling")
    return 0


def compile_in(part: Callable[[], None]) -> None:
    """Do a ``part`` in this process, which its parent ends; that has told for all of them what is waited for."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with redirect_stderr(io.StringIO()):
        part()


def localize_markers() -> None:
    """Localize the markers of small scans that are made for this."""
    from ronnaplan.localization import common_diameter, localize
    from ronnaplan.localization.fit.skin import share_on_skin

    for scan in made_scans():
        common_diameter(scan)
        found = localize(scan, diameter_mm=DIAMETER_MM, expected=len(MARKERS_MM))
    # What is held by more than a post, as nothing here is, is asked whether it lies on skin.
    share_on_skin(next(iter(found)).parameters, 1000.0)


def pair_markers() -> None:
    """Pair few points, and more than are listed in every order: of these some fit alike, or one, or two bodies."""
    import numpy as np

    from ronnaplan.correspondence import describe_layout, match_points

    describe_layout(NEARLY_A_SQUARE_MM).refusal_probability()
    few, covariances_mm2 = np.array(MARKERS_MM), np.array([0.01 * np.eye(3)] * len(MARKERS_MM))
    match_points(few, few[::-1].copy(), covariances_ct_mm2=covariances_mm2, covariances_ots_mm2=covariances_mm2)
    lattice = 20.0 * np.indices((3, 3, 2)).reshape(3, -1).T
    uneven = lattice + np.random.default_rng(0).normal(0.0, 8.0, lattice.shape)
    half_moved = uneven + 30.0 * (lattice[:, 2:] > 0.0)
    for points, others in ((lattice, lattice), (uneven, uneven), (uneven, half_moved)):
        match_points(points, others[::-1].copy())


def place_robot() -> None:
    """Find a place for one trajectory and one marker in the room of the example, on a little of its floor."""
    from dataclasses import replace

    import numpy as np

    from ronnaplan.documents.room_example import example_room
    from ronnaplan.robot.arm.kuka import kr6_r900
    from ronnaplan.robot.placement.blocking import at_reference
    from ronnaplan.robot.placement.job import Job
    from ronnaplan.robot.placement.placement import COARSE, find_places
    from ronnaplan.robot.placement.serving import served_by_each
    from ronnaplan.robot.placement.tasks import drill_task, view_task
    from ronnaplan.robot.placement.world import world_of

    whole = example_room()
    room = replace(
        whole, floor=replace(whole.floor, x_mm=(-800.0, -700.0), y_mm=(-600.0, -500.0), z_mm=(900.0, 900.0))
    )
    center = np.array(room.head.center_mm)
    tasks = (
        drill_task("", center + np.array([0.0, 0.0, 90.0]), center, room.tool, 150.0, 2.0),
        view_task("", center + np.array([0.0, 0.0, 100.0]), center, room.camera),
    )
    head = center + 80.0 * np.concatenate([np.eye(3), -np.eye(3)])
    tracker = None if room.tracker is None else np.array(room.tracker.position_mm)
    job = Job(kr6_r900(), room, np.eye(4), tasks, world_of(room, head, tracker))
    for place in find_places(job).places:  # as where no free move reaches a task's best way, or leads anywhere
        problem = job.problem(COARSE)
        next(served_by_each(problem, tasks[0], 0, place.room_from_r), None)
        at_reference(job, problem, place.room_from_r, place.route.reference_deg)


def see_sphere() -> None:
    """Find balls, and the noise about them, in images made for this: of two kinds, evenly bright and lit from aside."""
    import numpy as np

    from ronnaplan.robot.stereo.camera import Camera
    from ronnaplan.robot.stereo.outline import find_outlines
    from ronnaplan.robot.stereo.response import noise_beside

    camera = Camera(np.array([[1000.0, 0.0, 80.0], [0.0, 1000.0, 80.0], [0.0, 0.0, 1.0]]), np.zeros(5), np.eye(4))
    rows, columns = (one - 80.0 for one in np.mgrid[:160, :160])
    far = np.hypot(columns, rows)
    aside = 0.8 * np.sqrt(np.clip(1.0 - (far / 30.0) ** 2, 0.0, 1.0)) + 0.6 * columns / 30.0
    noise = np.random.default_rng(0).normal(0.0, 2.0, far.shape)
    for lit, kind in ((1.0, np.uint8), (0.4 + 0.6 * np.clip(aside, 0.0, 1.0), np.float64)):
        image = (20.0 + 150.0 * lit * np.clip(30.5 - far, 0.0, 1.0) + noise).astype(kind)
        for outline in find_outlines(image, camera):
            noise_beside(image, *outline.in_image(camera))


def made_scans() -> tuple[CTVolume, CTVolume]:
    """Return a noisy scan of balls in air, above a slab and beside bone; their shares of voxels are counted.

    Its values have fractions, of a rescale slope that is none, or of a program; then they are whole, as scanners store
    them.
    """
    import numpy as np

    from ronnaplan.ct import CTVolume

    spacing_mm = np.array([2.0, 1.0, 1.0])
    shape = (40, 96, 96)
    generator = np.random.default_rng(0)
    hu = np.full(shape, -1000.0) + generator.normal(0.0, 10.0, shape)
    hu[:3] += 1000.0
    hu[:, 82:] += 2000.0
    parts = (np.indices((2, 3, 3)).reshape(3, -1).T + 0.5) / (2, 3, 3) - 0.5
    kji = np.moveaxis(np.indices(shape), 0, -1).astype(np.float64)
    for x, y, z in MARKERS_MM:
        for part in parts:
            inside = np.linalg.norm((kji + part) * spacing_mm - (z, y, x), axis=-1) < DIAMETER_MM / 2
            hu[inside] += 1100.0 / len(parts)
    blurred = sum(np.roll(hu, step, axis=axis) for axis in (1, 2) for step in (-1, 0, 1)) / 6.0
    affine = np.zeros((4, 4))
    affine[2, 0], affine[1, 1], affine[0, 2], affine[3, 3] = *spacing_mm, 1.0
    whole = np.round(blurred).astype(np.int16)
    return CTVolume.from_array(blurred, affine), CTVolume.from_array(whole, affine)


PARTS = (localize_markers, place_robot, pair_markers, see_sphere)
"""What is compiled at once, by who shares hardly a loop; the longest first."""
