"""What the pages fetch to draw the head themselves: its things one by one, and the whole scan."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from aiohttp import web

from ronnaplan.planner.head_view import HeadView
from ronnaplan.scene.packed import packed


def head_routes(heads: Callable[[], Iterable[HeadView]]) -> list[web.RouteDef]:
    """Return what is answered of the ``heads`` of all pages."""

    async def thing(request: web.Request) -> web.Response:
        key = request.match_info["key"]
        found = (view.scene.thing(key) for view in heads() if view.scene is not None)
        one = next(filter(None, found), None)
        if one is None:
            raise web.HTTPNotFound(text="it is no longer shown")
        return web.json_response(packed(one))

    async def volume(_: web.Request) -> web.Response:
        made = next((view.parts.volume for view in heads() if view.parts.volume is not None), None)
        if made is None:
            raise web.HTTPNotFound(text="it is not made yet")
        return web.Response(body=made.packed, content_type="application/octet-stream")

    return [web.get("/things/{key}", thing), web.get("/volume", volume)]
