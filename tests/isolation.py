"""A network namespace with nothing in it but loopback (Linux, and only root may make one)."""

from __future__ import annotations

import socket
import struct
import sys

CLONE_NEWNET = 0x40000000
SIOCSIFFLAGS, IFF_UP, IFF_RUNNING = 0x8914, 0x1, 0x40


def isolate() -> None:
    """Move this process, and those it starts, into a network of its own, if it may."""
    if sys.platform != "linux":
        return
    import ctypes
    import fcntl

    if ctypes.CDLL(None).unshare(CLONE_NEWNET) == 0:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
            fcntl.ioctl(any_socket, SIOCSIFFLAGS, struct.pack("16sh14x", b"lo", IFF_UP | IFF_RUNNING))


def is_isolated() -> bool:
    """Whether there is no network here but loopback."""
    return [name for _, name in socket.if_nameindex()] == ["lo"]
