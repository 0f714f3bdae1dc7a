"""A DICOMweb archive for tests, which answers as a function says."""

from __future__ import annotations

import json
import ssl
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple

from ronnaplan.node.config import Peer


class Answer(NamedTuple):
    """Status, headers and content, in the pieces that it is sent in."""

    status: int
    headers: dict[str, str]
    content: Iterable[bytes]


Reply = Callable[[BaseHTTPRequestHandler], Answer]


@contextmanager
def web_archive(reply: Reply, tls: ssl.SSLContext | None = None) -> Iterator[Peer]:
    """Run an archive, encrypted or not; gives the peer that it is."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.rfile.read(int(self.headers.get("Content-Length", "0")))
            answer = reply(self)
            self.send_response(answer.status)  # HTTP 1.0: who closes the connection has said all
            for name, value in answer.headers.items():
                self.send_header(name, value)
            self.end_headers()
            with suppress(OSError):  # who asked has heard enough
                for piece in answer.content:
                    self.wfile.write(piece)

        def do_POST(self) -> None:
            self.do_GET()

        def log_message(self, *_: object) -> None:
            pass

    scheme, server = "http", ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    if tls is not None:
        scheme, server.socket = "https", tls.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield Peer(name="pacs", url=f"{scheme}://127.0.0.1:{server.server_port}")
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def is_list(path: str) -> bool:
    """Whether a path asks for a list: of studies, series or instances."""
    return path.endswith(("studies", "series", "instances"))


def list_of(entries: Iterable[Any], **headers: str) -> Answer:
    """Answer with a list of datasets, as they are in JSON."""
    kind = {"Content-Type": "application/dicom+json; charset=utf-8"}
    return Answer(200, {**kind, **headers}, [json.dumps(list(entries)).encode()])
