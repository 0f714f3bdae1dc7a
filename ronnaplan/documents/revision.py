"""Documents that are written whole carry a revision, so that who has read one can tell that it was changed since."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from ronnaplan.documents.files import change_document
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import InputError

if TYPE_CHECKING:
    from ronnaplan.documents.chain import ChainDocument
    from ronnaplan.documents.fiducials import FiducialsDocument
    from ronnaplan.documents.placement import PlacementDocument
    from ronnaplan.documents.registration import RegistrationDocument
    from ronnaplan.documents.rig import RigDocument, SpheresDocument
    from ronnaplan.documents.tool import HandEyeDocument, PivotDocument

Document = TypeVar(
    "Document",
    "FiducialsDocument",
    "RegistrationDocument",
    "PlacementDocument",
    "PivotDocument",
    "HandEyeDocument",
    "RigDocument",
    "SpheresDocument",
    "ChainDocument",
)


def revised(document: Document, there: Document | None) -> Document:
    """Return ``document`` with the revision that it has in the place of the one that is ``there``."""
    if there is None:
        return document.model_copy(update={"revision": 0})
    same = document.model_copy(update={"revision": there.revision})
    return same if same == there else document.model_copy(update={"revision": there.revision + 1})


def write_document(
    path: str | os.PathLike[str] | None,
    document: Document,
    read: Callable[[str | os.PathLike[str]], Document],
) -> Document:
    """Write ``document`` to ``path``, revised, in the place of whatever is there; without a path to standard output.

    Returns the document as written.
    """
    if path is None:
        sys.stdout.write(to_json(document))
        return document

    def there(place: str | os.PathLike[str]) -> Document | None:
        try:
            return read(place)
        except InputError:  # nothing, or something else
            return None

    def change(old: Document | None) -> Document | None:
        return revised(document, old)

    return change_document(path, there, change, lambda written: to_json(written or document)) or document
