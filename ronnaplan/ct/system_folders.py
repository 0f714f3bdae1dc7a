"""Folders that systems keep on every disk for themselves: what was deleted, indices, what a check of the disk found."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import Final

WHY_LEFT_OUT: Final = "it is the system's own, or was deleted; name that folder to look into it"
WHY_LEFT_PACKED: Final = (
    "its folder is the system's own, or was deleted; unpack the archive, then name that folder"
)

_DELETED: Final = frozenset({".trash", ".trashes", "$recycle.bin", "#recycle", "@recycle"})
"""Of macOS, of Windows, and of network disks by Synology and QNAP: a scan in them is one that somebody gave up."""
_OTHERS: Final = frozenset(
    {
        *(".documentrevisions-v100", ".fseventsd", ".spotlight-v100", ".temporaryitems"),
        *("system volume information", "lost+found"),
    }
)
"""What no user may look into, and what holds files that never were images."""
_TRASH_OF_USER: Final = re.compile(r"\.trash-\d+")
"""What was deleted by a user of Linux, on a disk that is not the user's home."""


def is_system_folder(name: str) -> bool:
    """Whether a folder of this name is the system's own.

    >>> [is_system_folder(one) for one in ("$Recycle.Bin", ".Trash-1000", "lost+found", "scans")]
    [True, True, True, False]
    """
    plain = name.lower()
    return plain in _DELETED or plain in _OTHERS or _TRASH_OF_USER.fullmatch(plain) is not None


def is_below_system_folder(path: str) -> bool:
    """Whether a file, by its path in an archive or the like, lies in a folder that is the system's own.

    >>> is_below_system_folder("disk/.Trashes/501/0.dcm"), is_below_system_folder("lost+found")
    (True, False)
    """
    return any(is_system_folder(folder) for folder in PurePosixPath(path).parts[:-1])
