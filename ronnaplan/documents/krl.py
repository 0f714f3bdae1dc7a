"""What KRL, the language of KUKA's controllers, takes: names, letters, and poses as frames."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray

LOCKED = 1e-7
"""Tool x axes nearer than this to the vertical leave A and C of a KUKA one free angle."""
LONGEST_KRL_NAME = 24
"""Characters of a name in KRL at most."""
KRL_WORDS: Final = re.compile(
    "AND|ANIN|ANOUT|AXIS|BOOL|BRAKE|B_AND|B_EXOR|B_NOT|B_OR|CASE|CCLOSE|CHANNEL|CHAR|CIRC|"
    "CIRC_REL|CONFIRM|CONST|CONTINUE|COPEN|CREAD|CWRITE|C_DIS|C_ORI|C_PTP|C_SPL|C_VEL|DECL|DEF|"
    "DEFAULT|DEFDAT|DEFFCT|DELAY|DIGIN|DISTANCE|DO|E6AXIS|E6POS|ELSE|END|ENDDAT|ENDFCT|ENDFOR|"
    "ENDIF|ENDLOOP|ENDSPLINE|ENDSTRUC|ENDSWITCH|ENDWHILE|ENUM|EXIT|EXOR|EXT|EXTFCT|FALSE|FOR|FRAME|"
    "GLOBAL|GOTO|HALT|IF|IMPORT|INT|INTERRUPT|IS|LIN|LIN_REL|LOOP|MAXIMUM|MINIMUM|NOT|OFF|ON|OR|"
    "POS|PRIO|PTP|PTP_REL|PUBLIC|PULSE|REAL|REPEAT|RESUME|RETURN|SCIRC|SEC|SIGNAL|SLIN|SPLINE|"
    "SPTP|SREAD|STEP|STRUC|SWITCH|SWRITE|SYNC|THEN|TO|TRIGGER|TRUE|UNTIL|WAIT|WHEN|WHILE|WITH"
)
"""What means something in the language, and names nothing else."""


def require_told_apart(names: Sequence[str]) -> None:
    """Raise `InputError` for two names that are the same in ASCII, the letters of KRL."""
    alike: dict[str, str] = {}
    for name in names:
        other = alike.setdefault(in_ascii(name), name)
        if other != name:
            raise InputError(
                f"the trajectories {other} and {name} look alike in the letters that KRL has (ASCII); rename one"
            )


def krl_names(names: Sequence[str]) -> dict[str, str]:
    """Return the name in KRL of each trajectory: letters, digits and ``_``, no more than the controller takes.

    >>> krl_names(["left STN", "left stn", "3rd", "frame"])
    {'left STN': 'LEFT_STN', 'left stn': 'LEFT_STN_2', '3rd': 'T_3RD', 'frame': 'T_FRAME'}
    """
    taken: dict[str, str] = {}
    for name in names:
        plain = re.sub(r"[^A-Z0-9]+", "_", name.upper()).strip("_") or "T"
        plain = plain if plain[0].isalpha() and not KRL_WORDS.fullmatch(plain) else f"T_{plain}"
        longest = LONGEST_KRL_NAME - len("_APP")
        candidate, number = plain[:longest], 1
        while candidate in taken.values():
            number += 1
            candidate = f"{plain[: longest - len(str(number)) - 1]}_{number}"
        taken[name] = candidate
    return taken


def krl_frame(matrix: FloatArray) -> str:
    """Return the content of a FRAME (mm, degrees) for a pose (4, 4)."""
    values = dict(zip("XYZABC", (*matrix[:3, 3], *krl_angles(matrix)), strict=True))
    return ",".join(f"{axis} {value:.6f}" for axis, value in values.items())


def krl_angles(matrix: FloatArray) -> tuple[float, float, float]:
    """Return A, B and C (degrees) of a pose: turns about Z, then the new Y, then the newest X.

    Where B is +-90 degrees, A and C turn about one line and C is 0.
    """
    (ux, vx, _), (uy, vy, _), (uz, vz, wz) = matrix[:3, :3].tolist()
    level = math.hypot(ux, uy)
    if level < LOCKED:
        angles = math.atan2(-vx, vy), math.atan2(-uz, level), 0.0
    else:
        angles = math.atan2(uy, ux), math.atan2(-uz, level), math.atan2(vz, wz)
    a, b, c = map(math.degrees, angles)
    return a, b, c


def in_ascii(text: str) -> str:
    """Return a text in the letters of KRL, a question mark for each other one."""
    return text.encode("ascii", "replace").decode()
