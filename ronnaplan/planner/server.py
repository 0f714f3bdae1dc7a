"""Starts the planner's web server and says where it is."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

from ronnaplan.errors import InputError, UsageError
from ronnaplan.planner.address import ADDRESS_FILE, GREATEST_PORT, Address, address_for, keep, needed_place
from ronnaplan.planner.state import PlannerState
from ronnaplan.text import printable

if TYPE_CHECKING:
    from aiohttp import web

    from ronnaplan.planner.app import PlannerApp
    from ronnaplan.planner.handing import Handing, Origin
    from ronnaplan.planner.starting import StartPage
    from ronnaplan.scene.vtk import Workshop

EVERYWHERE = ("", "0.0.0.0", "::")

_NUMBERS = count(1)
"""trame keeps what it knows of a server under its name; each case that is opened gets one of its own."""

LOOPBACK = frozenset({"127.0.0.1", "localhost"})


def serve(
    state: PlannerState,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    tracker: tuple[str, int] | None = None,
    patient: str | None = None,
    origin: Origin | None = None,
    address: Address | None = None,
    announce: Callable[[str], None] | None = None,
    workshop: Workshop | None = None,
) -> bool:
    """Serve ``state`` until stopped, or until a page asks for the start page: then return True.

    ``announce`` is given the address, which holds the token.

    ``patient`` is the name to show, None to show none. ``origin`` says where the scan was read, for report and scene.
    ``address`` is where a start page was, which the planner replaces and may go back to. ``workshop`` makes the
    head's surfaces; without one it is begun here.

    Raises `InputError` where the port is taken or trame is not installed, `UsageError` for no single address.
    """
    check_place(host, port)
    server = _trame_server()
    import wslink.backends.aiohttp

    from ronnaplan.planner.app import PlannerApp
    from ronnaplan.planner.handing import Handing
    from ronnaplan.planner.sockets import Sockets

    kept = state.storage.address
    known = address or address_for(kept, host, port)
    app = PlannerApp(state, server, tracker, patient, leavable=address is not None, workshop=workshop)
    # wslink offers no other place to set limits, or to answer each page for itself
    wslink.backends.aiohttp.AioHttpWsHandler = partial(Sockets, app)
    handing = Handing(state.storage, origin, app.show_readings, lambda: app.state.case.require_files())

    def tell(**_: Any) -> None:
        keep(kept, replace(known, port=server.port))
        if address is None:
            (announce or print_address)(_url(host, replace(known, port=server.port)))

    server.controller.on_server_bind.add(lambda web_server: _bind(web_server.app, app, handing, known.token, host))
    server.controller.on_server_ready.add(tell)
    server.controller.on_error = _repeat
    with needed_place(host, known.port):
        server.start(
            host=host,
            port=known.port,
            timeout=0,
            open_browser=False,
            show_connection_info=False,
            disable_logging=True,
        )
    app.forget()
    return app.left


def _trame_server() -> Any:
    """Return a server that says nothing by itself; raises `InputError` where trame is not installed."""
    try:
        import trame.ui.html  # noqa: F401
        import wslink.backends.aiohttp  # noqa: F401
        from trame.app import get_server
    except ModuleNotFoundError as error:
        raise InputError(f"the planner needs {error.name}; install ronnaplan[planner]") from error
    from ronnaplan.planner.gate import is_worth_telling

    os.environ["WSLINK_READY_MSG"] = ""  # wslink would write it to standard output, behind the address
    os.environ["WSLINK_WS_COMPRESS"] = "0"  # what takes room, the pictures, is compressed already
    logging.getLogger("aiohttp.server").addFilter(is_worth_telling)
    server = get_server(f"ronnaplan {next(_NUMBERS)}", client_type="vue3")
    server.cli.prog = "ronnaplan view"
    return server


def _bind(application: web.Application, app: PlannerApp, handing: Handing, token: str, host: str) -> None:
    """Let in only who knows the ``token``, and answer for page, head and files."""
    from ronnaplan.planner.gate import gate
    from ronnaplan.planner.head_view import head_routes
    from ronnaplan.planner.page_files import FETCHED_AHEAD, page_routes

    application.middlewares.append(gate(token, LOOPBACK | {host}, FETCHED_AHEAD))
    application.add_routes(page_routes())
    application.add_routes(head_routes(lambda: (tab.head for tab in app.tabs.values())))
    application.add_routes(handing.routes())


def _repeat(message: str) -> None:
    print(f"ronnaplan: the page says: {printable(message)}", file=sys.stderr)


def check_place(host: str, port: int) -> None:
    """Raise `UsageError` for a host or a port that cannot be listened on."""
    if host in EVERYWHERE:
        raise UsageError(f"--host {host} would listen everywhere; name the one address to be reached by")
    if not 0 <= port <= GREATEST_PORT:
        raise UsageError(f"--port {port} is no port; give one up to {GREATEST_PORT}, or 0 for any that is free")


def start(
    page: StartPage, *, host: str = "127.0.0.1", port: int = 0, address: Address | None = None
) -> tuple[PlannerState, Address]:
    """Serve the start page until a case is open; return it, and the address at which `serve` goes on.

    ``address`` is where a case was that was left.
    """
    from ronnaplan.planner.starting import choose

    check_place(host, port)
    kept = page.home / ADDRESS_FILE

    def announce(known: Address) -> None:
        keep(kept, known)
        if address is None:
            print_address(_url(host, known))

    return choose(page, host, LOOPBACK | {host}, address or address_for(kept, host, port), announce)


def _url(host: str, known: Address) -> str:
    return f"http://{host}:{known.port}/index.html?token={known.token}"


def print_address(address: str) -> None:
    """Say where the planner is."""
    print(address, flush=True)
    print("ronnaplan: open this address in a browser on this machine; Ctrl-C ends the planner", file=sys.stderr)
