"""Serve: a Source in, a page on this machine out, at 127.0.0.1 only.

Requests are answered by threads, but what is asked of the source is done by the thread that called `serve`: Mitsuba's
state belongs to a thread, and there Ctrl-C arrives.
"""

from __future__ import annotations

import contextlib
import queue
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from ..errors import InputError, LidarSceneError
from .page import page
from .sources import Source, settings_from

HOST = "127.0.0.1"
LARGEST_REQUEST = 1 << 16
POLL_S = 0.5  # a wait without end cannot be interrupted on Windows

Job = Callable[[], bytes]


class Server(ThreadingHTTPServer):
    """Has its port from the moment it is made until the block ends; answers while `serve` runs."""

    daemon_threads = True
    source: Source

    def __init__(self, port: int) -> None:
        """Port 0 takes any free one. Raises InputError where the port cannot be had."""
        self.jobs: queue.SimpleQueue[tuple[Job, Future[bytes]]] = queue.SimpleQueue()
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(f"--port {port}: cannot be had: {reason}; 0 takes any free one") from None

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.server_port}/"

    @property
    def names(self) -> tuple[str, ...]:
        """What a browser on this machine calls it."""
        return f"{HOST}:{self.server_port}", f"localhost:{self.server_port}"

    def serve(self, source: Source) -> None:
        """Answer until interrupted."""
        self.source = source
        threading.Thread(target=self.serve_forever, daemon=True).start()
        try:
            while True:
                with contextlib.suppress(queue.Empty):
                    self._do(*self.jobs.get(timeout=POLL_S))
        finally:
            self.shutdown()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that is closed breaks its connections; anything else is told in the terminal."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)

    def done(self, job: Job) -> bytes:
        """What a job gives, done by the serving thread. Called by the others."""
        future: Future[bytes] = Future()
        self.jobs.put((job, future))
        return future.result()

    @staticmethod
    def _do(job: Job, future: Future[bytes]) -> None:
        try:
            future.set_result(job())
        except Exception as error:
            future.set_exception(error)


class _Handler(BaseHTTPRequestHandler):
    """GET / is the page, /stage and /frame-N are blobs; POST /render takes settings and gives a blob."""

    server: Server
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def do_GET(self) -> None:
        source, name = self.server.source, self.path.partition("?")[0]
        if name == "/":
            self._answer(lambda: page(source.title).encode(), "text/html; charset=utf-8")
        elif name == "/stage":
            self._answer(source.stage)
        elif (number := _frame_number(name, len(source.frames))) is not None:
            self._answer(lambda: source.frame(number))
        else:
            self._send(HTTPStatus.NOT_FOUND, b"not found", "text/plain")

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if self.path != "/render" or not length.isdecimal() or int(length) > LARGEST_REQUEST:
            self.close_connection = True
            self._send(HTTPStatus.NOT_FOUND, b"not found", "text/plain")
            return
        body = self.rfile.read(int(length))
        self._answer(lambda: self.server.source.rendered(settings_from(body)))

    def _answer(self, job: Job, kind: str = "application/octet-stream") -> None:
        # Another site's name that was made to lead here is not ours: it must not read our answers.
        if self.headers.get("Host") not in self.server.names:
            self._send(HTTPStatus.FORBIDDEN, b"the host must be this viewer's own, got another", "text/plain")
            return
        try:
            self._send(HTTPStatus.OK, self.server.done(job), kind)
        except LidarSceneError as error:
            self._send(HTTPStatus.BAD_REQUEST, str(error).encode(), "text/plain; charset=utf-8")
        except Exception:
            self._send(HTTPStatus.INTERNAL_SERVER_ERROR, b"this failed; the terminal says why", "text/plain")
            raise

    def _send(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        with contextlib.suppress(ConnectionError):  # the page was closed meanwhile
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Nothing: the terminal is the user's."""


def _frame_number(name: str, count: int) -> int | None:
    text = name.removeprefix("/frame-")
    return int(text) if name != text and text.isdecimal() and int(text) < count else None
