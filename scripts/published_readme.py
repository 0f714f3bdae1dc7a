"""Build hook: the README as it is published with the package, without the source, where a link to a file leads nowhere.

Links to files become absolute beneath ``project.urls.Source``; as long as no such address is stated they become their
text, and pictures are left out.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

FILE_LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?P<path>[^)\s:#][^)\s:]*)\)")


def published(readme: str, version: str, source: str | None) -> str:
    """Return a README whose links are absolute: beneath the ``source``, at this version, where its address is known."""

    def link(found: re.Match[str]) -> str:
        if source is None:
            return "" if found["picture"] else found["text"]
        raw = "?raw=true" if found["picture"] else ""
        return f"{found['picture']}[{found['text']}]({source}/blob/v{version}/{found['path']}{raw})"

    return FILE_LINK.sub(link, readme)


class PublishedReadme(MetadataHookInterface):
    """What hatchling asks for ``project.readme``."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the readme of the ``project`` table."""
        readme = Path(self.root, "README.md").read_text(encoding="utf-8")
        text = published(readme, metadata["version"], metadata["urls"].get("Source"))
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
