"""The page's own files: its template, and its scripts as one, fetched before the page asks for them."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from aiohttp import web

from ronnaplan.planner.cuts import HEAD, PATH_VIEWS, STANDARD

PAGE = files("ronnaplan.planner") / "page"
SCENE_PAGE = files("ronnaplan.scene") / "page"

SCRIPT, STYLE = "page.js", "planner_page/planner.css"
FETCHED_AHEAD = ", ".join(
    f"<{name}>; rel=preload; as={kind}"
    for name, kind in (("vue.global.js", "script"), (STYLE, "style"), (SCRIPT, "script"))
)
"""The page asks for its style and script only when it has heard from the server: they come sooner, behind what it needs
for that."""

MODULE = {"serve": {"planner_page": str(Path(str(PAGE)))}, "scripts": [SCRIPT], "styles": [STYLE]}
"""What trame serves and loads before it makes the page."""


def templates() -> dict[str, str]:
    """Return the parts of the page by name: the browser compiles each when it first shows it.

    What is there for every view stands in it once, which is compiled sooner.
    """
    page, panels, view, cube = (
        (PAGE / f"{name}.html").read_text(encoding="utf-8") for name in ("planner", "panels", "view", "cube")
    )
    views = ", ".join(f"['{name}', drawn_{name}]" for name in (*STANDARD, HEAD, *PATH_VIEWS))
    view = view.replace("VIEWS", views).replace("<!-- head -->", cube)
    return {"main": page.replace("<!-- views -->", view), "panels": panels}


def page_routes() -> list[web.RouteDef]:
    """Return what is answered beside trame's own: all scripts at once."""
    parts = [
        *(SCENE_PAGE / f"{name}.js" for name in ("viewer", "volume")),
        *(PAGE / f"{name}.js" for name in ("planner", "head", "files", "pictures")),
    ]
    text = "".join(part.read_text(encoding="utf-8") for part in parts)

    async def script(_: web.Request) -> web.Response:
        return web.Response(text=text, content_type="text/javascript")

    return [web.get(f"/{SCRIPT}", script)]
