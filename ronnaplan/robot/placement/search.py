"""The search for bases: a grid over the floor, then steps that halve from the best of it, on all cores."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.wrist import shoulder_mm, stretched_mm
from ronnaplan.robot.placement.machine import Machine
from ronnaplan.robot.placement.room import Floor, base_pose
from ronnaplan.robot.placement.tasks import Ways
from ronnaplan.robot.placement.world import CLEARANCE_NEED, World
from ronnaplan.threads import cores, in_threads

GRID_MM = 100.0
GRID_Z_MM = 150.0
FACING_DEG = (0.0, 45.0, -45.0, 90.0, -90.0, 180.0)
"""Turns of the base that are tried, from that which faces the head."""
SPARE_MM = 300.0
"""Bases are looked at so much farther off than arm and instruments reach, so that none is left out that serves."""
ANY = 1e-6
"""Plenty, where it is only asked whether all is served."""
STARTS = 6
"""Places that are refined, beside the alternatives."""
ALTERNATIVES = 4
APART_MM = 150.0
"""So many places are refined that are this far apart."""
SLACK = 1e-6
"""Of a worth, by which another may be less and still as good."""
FIRST_STEP = (50.0, 50.0, 50.0, 20.0)
LAST_STEP_MM = 3.0
"""Steps in x, y, z (mm) and turn (degrees) to begin the refinement with, and the least of it."""
POLISHING_STEP, POLISHING_WAYS = (24.0, 24.0, 24.0, 10.0), 80
"""The same for the very best place, which is bettered in so many directions drawn at random."""
_OUT = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
_OUT = _OUT[np.abs(_OUT).sum(axis=1) > 0]
SIDES = np.concatenate(
    [
        np.column_stack([_OUT / np.linalg.norm(_OUT, axis=1, keepdims=True), np.zeros(len(_OUT))]),
        [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, -1.0]],
    ]
)
"""Which ways the refinement goes (28, 4)."""


@dataclass(frozen=True, eq=False)
class Problem:
    """All that bases are judged by; those that are sought stay apart from places (4,) that are ``taken``."""

    machine: Machine
    world: World
    ways: Ways
    floor: Floor
    taken: tuple[FloatArray, ...] = ()

    def __len__(self) -> int:
        return len(self.ways.steps)


def worths(problem: Problem, places: FloatArray, least: float = 0.0, plenty: float = np.inf) -> FloatArray:
    """Return the worth (N,) of bases at ``places`` (N, 4); below zero where a task is not served above ``least``.

    Worths above ``plenty`` are not told apart. Both save time.
    """
    from ronnaplan.robot.placement.judging import judge_base

    found = np.empty(len(places))

    def judge(rows: NDArray[np.int64]) -> None:
        order = np.arange(len(problem))
        worth, chosen = np.empty(len(problem)), np.zeros((len(problem), 2), dtype=np.int64)
        for row in rows:
            base = base_pose(places[row])
            found[row] = judge_base(
                problem.machine, problem.world, problem.ways, base, order, False, worth, chosen, least, plenty
            )

    shared_out(judge, len(places))
    return found


def shared_out(work: Callable[[NDArray[np.int64]], None], count: int) -> None:
    """Have all cores do ``work`` on numbers (n,) below ``count``, each on every so many: near places take as long."""
    parts = cores()
    list(in_threads(work, [np.arange(n, count, parts) for n in range(min(parts, count))]))


def serves(problem: Problem, places: FloatArray) -> NDArray[np.bool_]:
    """Return which (N,) of the bases at ``places`` (N, 4) serve every task."""
    return np.asarray(worths(problem, places, plenty=ANY) >= 0.0)


def grid(problem: Problem) -> FloatArray:
    """Return the places (N, 4) of the floor to begin with, each with the turns that face the head or lean from it.

    Turns that are not allowed are brought to where the allowed ones end, so that every place has one or more.
    """
    floor, head = problem.floor, problem.world.head_ball[:3]
    reach = _reach(problem)
    axes = [_spaced(*ends, step) for ends, step in _ranges(floor)]
    # of each axis first, as a floor of two hundred metres can be stated
    close = [axis[np.abs(axis - middle) < reach] for axis, middle in zip(axes, head, strict=True)]
    x, y, z = (axis.ravel() for axis in np.meshgrid(*close, indexing="ij"))
    near = np.linalg.norm(np.stack([x, y, z], axis=1) - head, axis=1) < reach
    x, y, z = x[near], y[near], z[near]
    facing = np.degrees(np.arctan2(head[1] - y, head[0] - x))
    found = [np.stack([x, y, z, _turned(floor, facing + turn)], axis=1) for turn in FACING_DEG]
    places = np.concatenate(found)
    _, firsts = np.unique(places, axis=0, return_index=True)
    return places[np.sort(firsts)]


def scattered(problem: Problem, count: int) -> FloatArray:
    """Return ``count`` places (N, 4) spread evenly over the floor and all turns, without those out of reach.

    For floors where what serves lies between the places of the `grid`.
    """
    from scipy.stats.qmc import Sobol

    floor = problem.floor
    least, greatest = np.array([floor.x_mm, floor.y_mm, floor.z_mm, floor.turn_deg]).T
    shares = Sobol(4, rng=np.random.default_rng(0)).random_base2(int(np.ceil(np.log2(count))))[:count]
    places: FloatArray = least + shares * (greatest - least)
    near = np.linalg.norm(places[:, :3] - problem.world.head_ball[:3], axis=1) < _reach(problem)
    kept: FloatArray = places[near]
    return kept


def _turned(floor: Floor, turns: FloatArray) -> FloatArray:
    """Return ``turns`` (N,) in degrees by whole turns among those allowed, or else the nearer end of these."""
    least, greatest = floor.turn_deg
    ahead = np.mod(turns - least, 360.0)
    beyond = ahead - (greatest - least)
    end = np.where(beyond < 360.0 - ahead, greatest, least)
    return np.where(beyond > 0.0, end, np.minimum(least + ahead, greatest))


def within(floor: Floor, places: FloatArray) -> FloatArray:
    """Return the places (N, 4) whose turn, by whole turns, is allowed; no more than the floor's own are left."""
    least, greatest = floor.turn_deg
    turned = places.copy()
    turned[:, 3] = _turned(floor, places[:, 3])
    # by how far they are ahead, as what is added to an end and taken off again may miss it by a rounding
    kept = np.mod(places[:, 3] - least, 360.0) <= greatest - least
    for axis, ends in enumerate((floor.x_mm, floor.y_mm, floor.z_mm)):
        kept &= (turned[:, axis] >= ends[0]) & (turned[:, axis] <= ends[1])
    chosen: FloatArray = turned[kept]
    return chosen


def refine(problem: Problem, start: FloatArray, worth: float) -> tuple[FloatArray, float]:
    """Return the best place (4,) found from ``start`` by steps to all 26 sides and in turn, and its worth."""
    return _bettered(problem, start, worth, np.array(FIRST_STEP), lambda: SIDES)


def refined(problem: Problem, places: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return places (M, 4) and their worths (M,) refined from the best of ``places`` (N, 4), of worths ``values`` (N,).

    They start from the best of all and from the best apart. Where what limits the very best cannot be bettered, as a
    view that is as poor from every base, those that are alike in it are refined further in their joints.
    """
    starts = {*best_apart(places, values, ALTERNATIVES), *best_apart(places, values, STARTS, 0.0)}
    each = [refine(problem, places[n], float(values[n])) for n in sorted(starts)]
    tops, better = np.array([place for place, _ in each]).reshape(-1, 4), np.array([worth for _, worth in each])
    if not len(better):
        return tops, better
    asked = asking(problem, float(better.max()))
    alike = np.flatnonzero(better >= better.max() * (1 - SLACK))
    by_joints = worths(asked, tops[alike])
    for n in np.argsort(-by_joints)[:STARTS]:
        tops[alike[n]], better[alike[n]] = refine(asked, tops[alike[n]], float(by_joints[n]))
    best = int(better.argmax())
    tops[best], better[best] = polished(asked, tops[best], float(worths(asked, tops[[best]])[0]))
    return tops, better


def polished(problem: Problem, place: FloatArray, worth: float) -> tuple[FloatArray, float]:
    """Return ``place`` (4,) bettered by steps that way and this, base and turn together, and its worth.

    Where two tasks limit the worth against each other, a place is better only in a narrow direction between the sides
    that `refine` goes to.
    """
    rng = np.random.default_rng(0)

    def ways() -> FloatArray:
        drawn = rng.normal(size=(POLISHING_WAYS, 4))
        lengths: FloatArray = np.linalg.norm(drawn, axis=1, keepdims=True)
        return np.asarray(drawn / lengths)

    return _bettered(problem, place, worth, np.array(POLISHING_STEP), ways)


def _bettered(
    problem: Problem, place: FloatArray, worth: float, step: FloatArray, ways: Callable[[], FloatArray]
) -> tuple[FloatArray, float]:
    """Return the best place (4,) found by steps in ``ways`` (N, 4), asked for anew each time, and its worth.

    The ``step`` (4,) is halved where none of them is better, down to `LAST_STEP_MM`.
    """
    while step[0] >= LAST_STEP_MM:
        tried = within(problem.floor, place + ways() * step)
        tried = tried[_is_apart(tried, problem.taken)]
        found = worths(problem, tried, least=worth) if len(tried) else np.full(1, -1.0)
        if found.max() > worth:
            place, worth = tried[found.argmax()], float(found.max())
        else:
            step = step / 2
    return place, worth


def asking(problem: Problem, worth: float) -> Problem:
    """Return ``problem`` asking for the clearance and view that ``worth`` allows for, and for joints beyond it.

    A view or a clearance that is poor from every base hides all else behind it: bases that are alike in it are then
    told apart by the joints.
    """
    world = problem.world
    kept = worth * (1 - SLACK)
    allowed = np.array([kept, np.radians(kept)])
    allowed = np.maximum(allowed / (1 + allowed / world.plenty), world.needs[CLEARANCE_NEED:])
    return replace(
        problem,
        world=world._replace(needs=np.concatenate([world.needs[:CLEARANCE_NEED], allowed]), plenty=allowed),
    )


def alternatives(problem: Problem, places: FloatArray, values: FloatArray) -> Iterator[FloatArray]:
    """Yield the best place (4,) apart from all that are taken, refined from the best of ``places`` (N, 4), and so on.

    ``values`` (N,) are their worths.
    """
    while True:
        free = np.where(_is_apart(places, problem.taken), values, -1.0)
        best = int(free.argmax())
        if free[best] < 0.0:
            return
        place, _ = refine(problem, places[best], float(values[best]))
        yield place
        problem = replace(problem, taken=(*problem.taken, place))


def _is_apart(places: FloatArray, others: Sequence[FloatArray]) -> NDArray[np.bool_]:
    """Whether each of ``places`` (N, 4) is `APART_MM` from all ``others`` (4,)."""
    apart = np.ones(len(places), dtype=np.bool_)
    for other in others:
        apart &= np.linalg.norm(places[:, :3] - other[:3], axis=1) >= APART_MM
    return apart


def best_apart(places: FloatArray, values: FloatArray, count: int, apart_mm: float = APART_MM) -> list[int]:
    """Return the numbers of up to ``count`` of the best places (N, 4) that serve all, ``apart_mm`` from each other."""
    chosen: list[int] = []
    for n in np.argsort(-values, kind="stable"):
        if values[n] < 0.0 or len(chosen) == count:
            break
        if all(np.linalg.norm(places[n, :3] - places[other, :3]) >= apart_mm for other in chosen):
            chosen.append(int(n))
    return chosen


def _reach(problem: Problem) -> float:
    """Return how far (mm) from the head's middle a base can stand at all: the arm stretched, and the longest tool."""
    wrist, ways = problem.machine.wrist, problem.ways
    tool = np.abs(ways.instruments[:, :6]).max(initial=0.0) + SPARE_MM
    arm = stretched_mm(wrist) + np.linalg.norm(wrist.axis_2) + abs(wrist.beside)
    foot = shoulder_mm(wrist) if wrist.backwards else wrist.origin
    return float(arm + tool + problem.world.head_ball[3] + np.linalg.norm(foot))


def _ranges(floor: Floor) -> list[tuple[tuple[float, float], float]]:
    return [(floor.x_mm, GRID_MM), (floor.y_mm, GRID_MM), (floor.z_mm, GRID_Z_MM)]


def _spaced(least: float, greatest: float, step: float) -> FloatArray:
    return np.linspace(least, greatest, 1 + int(np.ceil((greatest - least) / step)))
