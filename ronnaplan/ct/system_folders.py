"""Folders that are not looked into: what systems keep on every disk for themselves, and what is not finished.

Of the former there are what was deleted, indices, what a check of the disk found.
"""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import Final

WHY_LEFT_OUT: Final = "it is the system's own, was deleted, or is not finished; name that folder to look into it"
WHY_LEFT_PACKED: Final = (
    "its folder is the system's own, was deleted, or is not finished; unpack the archive, then name that folder"
)

UNFINISHED: Final = ".ronnaplan.part"
"""Where files lie of which more are to come, in the folder that they are for."""
_DELETED: Final = frozenset({".trash", ".trashes", "$recycle.bin", "#recycle", "@recycle"})
"""Of macOS, of Windows, and of network disks by Synology and QNAP: a scan in them is one that somebody gave up."""
_OTHERS: Final = frozenset(
    {
        *(".documentrevisions-v100", ".fseventsd", ".spotlight-v100", ".temporaryitems"),
        *("system volume information", "lost+found", UNFINISHED),
    }
)
"""What no user may look into, what holds files that never were images, and a part that would be taken for the whole."""
_TRASH_OF_USER: Final = re.compile(r"\.trash-\d+")
"""What was deleted by a user of Linux, on a disk that is not the user's home."""


def is_system_folder(name: str) -> bool:
    """Whether a folder of this name is the system's own, or not finished.

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
