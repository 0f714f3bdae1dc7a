"""Who may talk to the planner: only browsers that know the token, on the host it listens on."""

from __future__ import annotations

import hmac
import logging
import re
from collections.abc import Awaitable, Callable

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.typedefs import Middleware

INDEX = "/index.html"

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

HOST = re.compile(r"(?P<name>\[[0-9A-Fa-f:.]+\]|[^\s:@/\[\]]+)(?::(?P<port>[0-9]{1,5}))?")
"""How a browser names the host that it asks, with the port unless it is 80."""

POLICY = (
    "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'; font-src 'self' data:; "
    "script-src 'self' 'unsafe-eval' 'unsafe-inline'; connect-src 'self'; frame-ancestors 'none'"
)
"""Nothing is fetched from any other host. The page's templates are compiled in the browser, hence 'unsafe-eval'."""


def gate(token: str, hosts: frozenset[str], ahead: str = "") -> Middleware:
    """Return a middleware that lets through what carries ``token`` and is addressed to one of ``hosts``.

    The token comes in the URL the first time and in a cookie from then on, also for the web socket. Names other
    than ``hosts`` are refused, so that no foreign web page can reach the planner through a name of its own. ``ahead``
    is sent with the page as its header Link: what the browser is to fetch before the page itself asks for it.
    """

    @web.middleware
    async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
        address = HOST.fullmatch(request.host)
        if address is None or address["name"].strip("[]").lower() not in hosts or not _own_origin(request):
            raise web.HTTPForbidden(text="this planner is not reached by that name")
        name = f"ronnaplan_{address['port'] or 80}"
        given = request.query.get("token") or request.cookies.get(name, "")
        if not hmac.compare_digest(given.encode(errors="replace"), token.encode()):
            raise web.HTTPForbidden(text="open the planner with the address that ronnaplan view printed")
        try:
            response = await handler(request)
        except web.HTTPException as error:
            error.set_cookie(name, token, httponly=True, samesite="Strict")
            raise
        if not response.prepared:
            response.set_cookie(name, token, httponly=True, samesite="Strict")
            response.headers["Content-Security-Policy"] = POLICY
            response.headers["Referrer-Policy"] = "no-referrer"
            response.headers["Cache-Control"] = "no-store"
            if ahead and request.path == INDEX:
                response.headers["Link"] = ahead
        return response

    return check


def _own_origin(request: web.Request) -> bool:
    origin = request.headers.get("Origin")
    return origin in (None, f"http://{request.host}", f"https://{request.host}")


def is_worth_telling(record: logging.LogRecord) -> bool:
    """Whether a record of the web server is of more than a request that was no HTTP, which was refused already."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError)
