"""Named materials: what they are made of, how dense, and what a head CT shows for them.

Compositions: tissues after ICRU Report 44 and ICRP 89, plastics and alloys by their formula (mass fractions).
"""

from __future__ import annotations

from dataclasses import dataclass

from phantoms.errors import PhantomError


@dataclass(frozen=True)
class Material:
    """``mass_fractions`` by element symbol; ``nominal_hu`` is what the fast renderer draws.

    That is the full scanner's value at 120 kV (60 mm rods, 12 mm for bone and metal), capped at 31000.
    """

    name: str
    density_g_cm3: float
    mass_fractions: dict[str, float]
    nominal_hu: float


_SOFT = {
    "H": 0.102,
    "C": 0.143,
    "N": 0.034,
    "O": 0.710,
    "Na": 0.001,
    "P": 0.002,
    "S": 0.003,
    "Cl": 0.002,
    "K": 0.003,
}
_CELLULOSE = {"C": 0.444, "H": 0.062, "O": 0.494}
_KERATIN = {"H": 0.066, "C": 0.505, "N": 0.164, "O": 0.219, "S": 0.046}
_ENAMEL = {"H": 0.010, "C": 0.010, "O": 0.426, "Mg": 0.003, "P": 0.177, "Ca": 0.374}

MATERIALS: dict[str, Material] = {
    material.name: material
    for material in (
        Material("air", 0.0012, {"N": 0.755, "O": 0.232, "Ar": 0.013}, -1000.0),
        Material("water", 1.0, {"H": 0.1119, "O": 0.8881}, 0.0),
        Material("skin", 1.09, {"H": 0.100, "C": 0.204, "N": 0.042, "O": 0.645, "S": 0.002, "Cl": 0.003}, 70.0),
        Material(
            "fat",
            0.95,
            {"H": 0.114, "C": 0.598, "N": 0.007, "O": 0.278, "Na": 0.001, "S": 0.001, "Cl": 0.001},
            -86.0,
        ),
        Material("soft tissue", 1.05, _SOFT, 45.0),
        Material(
            "brain",
            1.04,
            {"H": 0.107, "C": 0.145, "N": 0.022, "O": 0.712, "P": 0.004, "Cl": 0.003, "K": 0.003},
            35.0,
        ),
        Material("cerebrospinal fluid", 1.007, {"H": 0.111, "O": 0.880, "Na": 0.005, "Cl": 0.004}, 8.0),
        Material(
            "skull",
            1.61,
            {"H": 0.050, "C": 0.212, "N": 0.040, "O": 0.435, "Mg": 0.002, "P": 0.081, "S": 0.003, "Ca": 0.176},
            990.0,
        ),
        Material(
            "cortical bone",
            1.92,
            {"H": 0.034, "C": 0.155, "N": 0.042, "O": 0.435, "Mg": 0.002, "P": 0.103, "S": 0.003, "Ca": 0.225},
            1780.0,
        ),
        Material(
            "diploe",
            1.25,
            {"H": 0.085, "C": 0.404, "N": 0.028, "O": 0.367, "P": 0.034, "S": 0.002, "Ca": 0.080},
            450.0,
        ),
        Material("tooth", 2.3, _ENAMEL, 2880.0),
        Material("foam", 0.05, {"C": 0.85, "H": 0.15}, -950.0),
        Material("polyethylene", 0.95, {"C": 0.8563, "H": 0.1437}, -87.0),
        Material("plastic", 1.08, {"C": 0.8563, "H": 0.0774, "N": 0.0663}, -12.0),
        Material("nylon", 1.14, {"C": 0.6369, "H": 0.0980, "N": 0.1238, "O": 0.1414}, 74.0),
        Material("acrylic", 1.18, {"C": 0.5998, "H": 0.0805, "O": 0.3196}, 107.0),
        Material("polyoxymethylene", 1.41, {"C": 0.400, "H": 0.0671, "O": 0.5329}, 330.0),
        Material("PEEK", 1.31, {"C": 0.7908, "H": 0.0419, "O": 0.1665}, 178.0),
        Material("carbon fibre", 1.55, {"C": 0.90, "H": 0.03, "O": 0.07}, 372.0),
        Material("PVC", 1.30, {"C": 0.45, "H": 0.065, "O": 0.085, "Cl": 0.400}, 640.0),
        Material("polyester", 1.38, {"C": 0.625, "H": 0.042, "O": 0.333}, 257.0),
        Material("silicone", 1.30, {"C": 0.308, "H": 0.078, "O": 0.218, "Si": 0.356, "Ba": 0.040}, 1490.0),
        Material("glass", 2.5, {"Si": 0.337, "O": 0.460, "Na": 0.104, "Ca": 0.074, "Mg": 0.025}, 1850.0),
        Material(
            "glass beads", 1.75, {"Si": 0.270, "O": 0.430, "Na": 0.083, "Ca": 0.06, "C": 0.14, "H": 0.017}, 985.0
        ),
        Material("gel", 1.02, {"H": 0.108, "C": 0.050, "O": 0.830, "Na": 0.005, "Cl": 0.007}, 22.0),
        Material("cloth", 0.45, _CELLULOSE, -580.0),
        Material("gauze", 0.15, _CELLULOSE, -861.0),
        Material("loose hair", 0.05, _KERATIN, -952.0),
        Material("hair", 0.60, _KERATIN, -417.0),
        Material("ceramic", 3.9, {"Al": 0.5293, "O": 0.4707}, 3320.0),
        Material("aluminium", 2.70, {"Al": 1.0}, 2440.0),
        Material("copper", 8.96, {"Cu": 1.0}, 31000.0),
        Material("titanium", 4.43, {"Ti": 0.90, "Al": 0.06, "V": 0.04}, 8800.0),
        Material("steel", 7.9, {"Fe": 0.70, "Cr": 0.18, "Ni": 0.12}, 19000.0),
        Material("amalgam", 11.0, {"Hg": 0.50, "Ag": 0.35, "Sn": 0.12, "Cu": 0.03}, 31000.0),
        Material("gold", 19.3, {"Au": 1.0}, 31000.0),
        Material("silver", 10.5, {"Ag": 1.0}, 31000.0),
    )
}
"""Every material a scene may name."""


def material(name: str) -> Material:
    """Return the material called ``name``; raises `PhantomError` with the known names."""
    try:
        return MATERIALS[name]
    except KeyError:
        raise PhantomError(f"unknown material {name!r}; expected one of {', '.join(sorted(MATERIALS))}") from None
