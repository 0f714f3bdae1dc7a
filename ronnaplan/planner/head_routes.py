"""What the pages fetch to draw the head themselves: its things, and the whole scan."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from aiohttp import web

from ronnaplan.planner.head_view import HeadView
from ronnaplan.scene.packed import packed


def head_routes(heads: Callable[[], Iterable[HeadView]]) -> list[web.RouteDef]:
    """Return what is answered of the ``heads`` of all pages: each thing by its key, those that are still shown."""

    async def things(request: web.Request) -> web.Response:
        scenes = [view.scene for view in heads() if view.scene is not None]
        keys = set(request.match_info["keys"].split(","))
        found = {key: one for key in keys for scene in scenes if (one := scene.thing(key)) is not None}
        return web.json_response({key: packed(one) for key, one in found.items()})

    async def volume(_: web.Request) -> web.Response:
        made = next((view.parts.volume for view in heads() if view.parts.volume is not None), None)
        if made is None:
            raise web.HTTPNotFound(text="it is not made yet")
        return web.Response(body=made.packed, content_type="application/octet-stream")

    return [web.get("/things/{keys}", things), web.get("/volume", volume)]
