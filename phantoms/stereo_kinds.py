"""Which scenes of a sphere before two cameras there are, and whether it is to be measured in them, or refused."""

from __future__ import annotations

from dataclasses import dataclass, replace

DIAMETER_MM = 11.5


@dataclass(frozen=True)
class Scene:
    """What is seen; brightness is in grey levels of eight bits, shares are of one."""

    name: str
    verdict: str = "accept"
    """``accept``, ``refuse`` or ``either``: what a person would do."""
    shading: str = "even"
    """``even`` (retro-reflective), ``cosine`` (lit from the camera), ``lamp`` (from beside it), ``side`` (lit from
    aside, and from all around), or ``disc`` (no ball at all, but a flat disc facing the rig)."""
    spheres: int = 1
    diameter_mm: float = DIAMETER_MM
    bright: tuple[float, float] = (110.0, 210.0)
    """Range of the ball's brightness."""
    fall: tuple[float, float] = (0.0, 0.0)
    """Range of the share of brightness that is lost from one side of the ball to the other."""
    hidden: tuple[float, float] = (0.0, 0.0)
    """Range of the share of the outline that something in front hides, in one camera or both."""
    glare: tuple[float, float] = (0.0, 0.0)
    """Range of the width of a bright blob on the limb, in radii of the ball."""
    post: tuple[float, float] = (0.0, 0.0)
    """Range of the width of a post as bright as the ball, in diameters of the ball."""
    slope: tuple[float, float] = (0.0, 12.0)
    """Range of the ground's difference of brightness across the image."""
    glints: int = 0
    beside: tuple[float, float] = (0.0, 0.0)
    """Range of the angle (degrees) between the lines from the ball to a lamp and to the camera."""
    power: float = 1.0
    """Light of a lamp beside the camera falls off as the cosine to this power."""
    cable: tuple[float, float] = (0.0, 0.0)
    """Range of the width of a cable across the ball, in diameters of the ball."""
    gloss: tuple[float, float] = (0.0, 0.0)
    """Range of the brightness of a highlight near its middle, as a share of the ball's."""


BASE = Scene("evenly bright")
SCENES = (
    BASE,
    replace(BASE, name="gradient 20 %", fall=(0.2, 0.2)),
    replace(BASE, name="gradient 50 %", fall=(0.5, 0.5)),
    replace(BASE, name="limb darkens as the cosine", shading="cosine"),
    replace(BASE, name="lit from aside", verdict="either", shading="side"),
    replace(BASE, name="blob on the limb", glare=(0.1, 0.25)),
    replace(BASE, name="18-22 % hidden", hidden=(0.18, 0.22)),
    replace(BASE, name="25-33 % hidden", hidden=(0.25, 0.33)),
    replace(BASE, name="bright base", post=(0.4, 0.6)),
    replace(BASE, name="sloping ground", slope=(60.0, 100.0)),
    replace(BASE, name="dim beside reflections", bright=(45.0, 70.0), glints=12),
    replace(BASE, name="all at once", fall=(0.1, 0.3), glare=(0.05, 0.15), post=(0.2, 0.4), glints=6),
    replace(BASE, name="half hidden", verdict="refuse", hidden=(0.5, 0.6)),
    replace(BASE, name="flat disc", verdict="refuse", shading="disc"),
    replace(BASE, name="20 % smaller", verdict="refuse", diameter_mm=0.8 * DIAMETER_MM),
    replace(BASE, name="20 % larger", verdict="refuse", diameter_mm=1.2 * DIAMETER_MM),
    replace(BASE, name="none", verdict="refuse", spheres=0, glints=12),
    replace(BASE, name="two", verdict="refuse", spheres=2),
    replace(BASE, name="cosine, uneven and hidden", shading="cosine", fall=(0.1, 0.3), hidden=(0.18, 0.22)),
    replace(BASE, name="lamp 1 degree beside the lens", verdict="either", shading="lamp", beside=(1.0, 1.0)),
    replace(BASE, name="lamp 2 to 10 degrees beside", verdict="either", shading="lamp", beside=(2.0, 10.0)),
    replace(BASE, name="lamp 0 to 0.1 degrees beside", shading="lamp", beside=(0.0, 0.1)),
    replace(BASE, name="cosine, slightly uneven", shading="cosine", fall=(0.0, 0.05)),
    replace(BASE, name="slightly uneven, lamp beside", verdict="either", shading="lamp", fall=(0, 0.05), beside=(0, 1)),
    replace(BASE, name="cosine to 1.5, lamp beside", verdict="either", shading="lamp", beside=(0, 10), power=1.5),
    replace(BASE, name="cosine to 2, lamp beside", verdict="either", shading="lamp", beside=(0, 10), power=2.0),
    replace(BASE, name="cable across", cable=(0.02, 0.2)),
    replace(BASE, name="highlight in the middle", gloss=(0.2, 1.0)),
    replace(BASE, name="flat disc, cable across", verdict="refuse", shading="disc", cable=(0.02, 0.2)),
    replace(BASE, name="half hidden, highlight", verdict="refuse", hidden=(0.5, 0.6), gloss=(0.2, 1.0)),
    Scene("overexposed", bright=(260.0, 380.0)),
    Scene("overexposed, gradient", bright=(250.0, 380.0), fall=(0.1, 0.5)),
)  # fmt: skip
"""The table's rows."""
