"""Small changes to bytes that a parser should survive; a border adds those that know its format."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Sequence
from typing import Final

Mutation = Callable[[bytearray, random.Random], None]
HEADER_BYTES: Final = 1400
"""Most changes of numbers are made within the first bytes, where headers are."""
INTERESTING: Final = (0, 1, 2, 7, 0x7F, 0xFF, 0x7FFF, 0x8000, 0xFFFE, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFE, 0xFFFFFFFF)
NUMBERS: Final = (
    *(b"0", b"-0", b"-1", b"0.5", b"99999", b"1e30", b"1e308", b"1e-9", b"nan", b"inf", b"-inf"),
    *(b"", b"\\", b"1_0", b"+5", b" 3", b"0x10", b"1,5", b"9" * 40, b"9" * 400, b"9" * 5000),
)
"""Texts in the place of a number."""


def flip(data: bytearray, chance: random.Random) -> None:
    """Turn one to eight bits over, anywhere."""
    for _ in range(chance.choice((1, 1, 1, 2, 8))):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)


def flip_header(data: bytearray, chance: random.Random) -> None:
    """Set one byte of the header to anything."""
    data[chance.randrange(min(len(data), HEADER_BYTES))] = chance.randrange(256)


def set_number(data: bytearray, chance: random.Random) -> None:
    """Write an interesting integer of two or four bytes anywhere."""
    form = chance.choice(("<H", ">H", "<L", ">L"))
    at = chance.randrange(max(1, len(data) - 4))
    value = chance.choice(INTERESTING) & (0xFFFF if form[1] == "H" else 0xFFFFFFFF)
    data[at : at + struct.calcsize(form)] = struct.pack(form, value)


def change_digit(data: bytearray, chance: random.Random) -> None:
    """Replace one digit of the header by another character of a number."""
    digits = [at for at in range(min(len(data), HEADER_BYTES)) if 0x30 <= data[at] <= 0x39]
    if digits:
        data[chance.choice(digits)] = chance.choice(b"0123456789.-+eE\\ ")


def truncate(data: bytearray, chance: random.Random) -> None:
    """Cut off the end."""
    del data[chance.randrange(len(data)) :]


def delete(data: bytearray, chance: random.Random) -> None:
    """Take out a few bytes."""
    at = chance.randrange(len(data))
    del data[at : at + chance.choice((1, 2, 8, 64))]


def repeat(data: bytearray, chance: random.Random) -> None:
    """Put a run of bytes twice."""
    at, count = chance.randrange(len(data)), chance.choice((2, 8, 64, 300))
    data[at:at] = data[at : at + count]


ANYWHERE: Final[Sequence[Mutation]] = (
    *(flip, flip_header, set_number, change_digit) * 2,
    *(truncate, delete, repeat),
)
"""Mutations of any bytes, those that seldom break the whole twice as often."""


def mutate(data: bytearray, mutations: Sequence[Mutation], chance: random.Random) -> None:
    """Make one to three changes."""
    for _ in range(chance.choice((1, 1, 2, 3))):
        if len(data) > 8:
            chance.choice(mutations)(data, chance)
