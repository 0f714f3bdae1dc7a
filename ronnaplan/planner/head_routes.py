"""What the pages fetch to draw the head themselves: its things, and the whole scan."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from aiohttp import web

from ronnaplan.planner.head_view import HeadView
from ronnaplan.scene.packed import packed


def head_routes(heads: Callable[[], Iterable[HeadView]]) -> list[web.RouteDef]:
    """Return what is answered of the ``heads`` of all pages: of things, null where one is no longer shown."""

    async def things(request: web.Request) -> web.Response:
        scenes = [view.scene for view in heads() if view.scene is not None]
        found = (
            next((one for scene in scenes if (one := scene.thing(key)) is not None), None)
            for key in request.match_info["keys"].split(",")
        )
        return web.json_response([None if one is None else packed(one) for one in found])

    async def volume(_: web.Request) -> web.Response:
        made = next((view.parts.volume for view in heads() if view.parts.volume is not None), None)
        if made is None:
            raise web.HTTPNotFound(text="it is not made yet")
        return web.Response(body=made.packed, content_type="application/octet-stream")

    return [web.get("/things/{keys}", things), web.get("/volume", volume)]
