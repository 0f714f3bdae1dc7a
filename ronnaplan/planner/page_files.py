"""The page's own files: what it begins with, its template, and its scripts as one, fetched before it asks for them."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path

from aiohttp import web

from ronnaplan.planner.cuts import HEAD, PATH_VIEWS, STANDARD
from ronnaplan.planner.gate import INDEX

PAGE = files("ronnaplan.planner") / "page"
SCENE_PAGE = files("ronnaplan.scene") / "page"

SCRIPT, STYLE = "page.js", "planner_page/planner.css"
FETCHED_AHEAD = ", ".join(f"<{name}>; rel=preload; as=script" for name in ("vue.global.js", SCRIPT))
"""The page asks for its script only when it has heard from the server: it comes sooner, behind what that needs."""

MODULE = {"serve": {"planner_page": str(Path(str(PAGE)))}, "scripts": [SCRIPT]}
"""What trame serves and loads before it makes the page."""

LOADER = re.compile(r"<script>\s*fetch\(\"\./loading\.tpl\".*?</script>", re.DOTALL)
"""trame's index writes a picture of waiting over whatever stands in the page once it has come. Where much else runs, or
over a slow line, that is the page itself."""

VIEWPORT = re.compile('content="width=device-width,[^"]*"')
"""trame's index forbids that a person with weak eyes enlarges the page with two fingers."""

WAITING = "ronnaplan is loading ... (research software, not a medical device)"


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


def index() -> str:
    """Return what a browser is given first: trame's page, which says that it loads and looks whether that fails."""
    from trame_client.module import vue3

    text = LOADER.sub("", (Path(vue3.www) / "index.html").read_text(encoding="utf-8"))
    text = VIEWPORT.sub('content="width=device-width,initial-scale=1"', text)
    reach = (PAGE / "reach.js").read_text(encoding="utf-8")
    text = re.sub("<title>.*?</title>", f'<title>ronnaplan</title><link rel="stylesheet" href="{STYLE}">', text)
    text = text.replace('<div id="app">', f'<div id="app">{WAITING}')
    return text.replace("</body>", f"<script>{reach}</script></body>")


def page_routes() -> list[web.RouteDef]:
    """Return what is answered beside trame's own: what the page begins with, and all its scripts at once."""
    parts = [
        *(SCENE_PAGE / f"{name}.js" for name in ("viewer", "volume")),
        *(PAGE / f"{name}.js" for name in ("planner", "head", "files", "pictures")),
    ]
    text, first = "".join(part.read_text(encoding="utf-8") for part in parts), index()

    async def page(_: web.Request) -> web.Response:
        return web.Response(text=first, content_type="text/html")

    async def script(_: web.Request) -> web.Response:
        return web.Response(text=text, content_type="text/javascript")

    return [web.get(INDEX, page), web.get(f"/{SCRIPT}", script)]
