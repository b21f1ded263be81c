"""Server of the page for one source, at 127.0.0.1 only.

Threads answer the requests, one at a time behind the gate to the device (`kernel.device.gate`): the source's work is
tracing.
"""

from __future__ import annotations

import contextlib
import re
import socket
import sys
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from ..errors import LidarSceneError, OptionError
from ..kernel.device.gate import exclusive
from .html_page import page
from .page_sources import Source, blob_of, settings_from

HOST = "127.0.0.1"
LARGEST_REQUEST = 1 << 16
MOST_CONNECTIONS = 32
"""Most connections at a time. A browser opens six; each has a thread, so a script must not open thousands."""

PATIENCE_S = 10.0
"""Choice: time limit for a request to arrive and for an answer to be read: half a request would block its thread for
ever."""

HANG_UP_S = 2.0
"""Choice: time limit for the thread of a connection that is hung up on to end."""

SECURITY = {
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Headers of every answer: no other site may embed the page or read its data."""

Job = Callable[[], bytes]


class Server(ThreadingHTTPServer):
    """HTTP server that holds its port from its creation to the end of the block, and answers while `serve` runs."""

    daemon_threads = True
    source: Source

    def __init__(self, port: int) -> None:
        """Port 0 takes any free one.

        Raises:
            InputError: if the port is not available
        """
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self._is_over = False
        self._waiting: dict[_Handler, None] = {}
        """Connections whose next request has not arrived as a whole, the oldest first."""
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            reason = error.strerror or str(error)
            raise OptionError("{port} {0}: cannot be had: {1}; 0 takes any free one", port, reason) from None

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_port}/"

    @property
    def names(self) -> tuple[str, ...]:
        """Host headers that a browser on this machine sends."""
        return f"{HOST}:{self.server_port}", f"localhost:{self.server_port}"

    def serve(self, source: Source) -> None:
        """Answer until interrupted."""
        self.source = source
        try:
            self.serve_forever()
        finally:
            self._end_work()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a new thread; if all connections are taken, in place of the one that has sent nothing for longest.

        If all of them are answered at the moment, with 503.
        """
        if not self._free.acquire(blocking=False) and not self._make_room():
            with contextlib.suppress(OSError):
                request.sendall(b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n")
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:
            self._free.release()
            raise

    def _make_room(self) -> bool:
        """Hang up on the connection that has waited for a request for longest; True if its place is ours."""
        # A script that opens connections and sends half a request on each must not lock the page out.
        with contextlib.suppress(StopIteration, RuntimeError):  # none waits, or one began or ended to wait just now
            next(iter(self._waiting)).hang_up()
            return self._free.acquire(timeout=HANG_UP_S)
        return False

    def await_request(self, handler: _Handler) -> None:
        """Remember a connection that may be hung up on."""
        self._waiting[handler] = None

    def has_request(self, handler: _Handler) -> None:
        """Forget it: its request has arrived, or it is over."""
        self._waiting.pop(handler, None)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer all requests of one connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore connections broken by a closed page; print anything else in the terminal."""
        if not isinstance(sys.exc_info()[1], (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)

    @exclusive
    def run_job(self, job: Job) -> bytes:
        """Run a job of the source, and return its result."""
        if self._is_over:
            raise ConnectionAbortedError("the server has ended")
        return job()

    @exclusive
    def _end_work(self) -> None:
        """Wait for the job that runs, and run no more: the process must not end while a thread traces."""
        self._is_over = True


class _Handler(BaseHTTPRequestHandler):
    """Request handler: GET / is the page, /stage and /frame-N are blobs; POST /render turns settings into a blob."""

    server: Server
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    timeout = PATIENCE_S  # of each read and write; all reads of a request together have as long

    def handle_one_request(self) -> None:
        """Answer one request, with a limit on its arrival as a whole: the timeout holds for each byte alone."""
        self._arrival = threading.Timer(PATIENCE_S, self.hang_up)
        self._arrival.daemon = True
        self._arrival.start()
        self.server.await_request(self)
        try:
            super().handle_one_request()
        finally:
            self._has_arrived()

    def _has_arrived(self) -> None:
        """The request is whole, or over: from now on its answer may take minutes."""
        self._arrival.cancel()
        self.server.has_request(self)

    def hang_up(self) -> None:
        """End the connection, from any thread."""
        with contextlib.suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)

    def end_headers(self) -> None:
        """Add the security headers to every answer, including errors that the base class sends."""
        for name, value in SECURITY.items():
            self.send_header(name, value)
        super().end_headers()

    def do_GET(self) -> None:
        """Answer with the page or a blob."""
        source = self.server.source
        if self.path.partition("?")[0] == "/":
            self._answer(lambda: page(source.title).encode(errors="backslashreplace"), "text/html; charset=utf-8")
        elif (job := blob_of(source, self.path.removeprefix("/"))) is not None:
            self._answer(job)
        else:
            self._send(HTTPStatus.NOT_FOUND, b"not found", "text/plain")

    def do_POST(self) -> None:
        """Answer with the frame rendered under the settings in the body."""
        # A refused request closes the connection: its unread body would be parsed as the next request.
        if self.path != "/render":
            self._refuse(HTTPStatus.NOT_FOUND, b"not found")
            return
        # A form of another site can send a request here, though it cannot read the answer.
        origin = self.headers.get("Origin")
        if origin is not None and origin not in [f"http://{name}" for name in self.server.names]:
            self._refuse(HTTPStatus.FORBIDDEN, b"the origin must be this viewer's own page, got another")
            return
        lengths = self.headers.get_all("Content-Length", [])
        if len(lengths) != 1 or not re.fullmatch("[0-9]{1,9}", lengths[0]) or "Transfer-Encoding" in self.headers:
            self._refuse(HTTPStatus.BAD_REQUEST, b"the request must have one Content-Length")
            return
        length = int(lengths[0])
        if length > LARGEST_REQUEST:
            message = b"the request must have at most %d bytes" % LARGEST_REQUEST
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, message)
            return
        body = self.rfile.read(length)
        if len(body) < length:
            self._refuse(HTTPStatus.BAD_REQUEST, b"the request ended before its Content-Length")
            return
        self._answer(lambda: self.server.source.render(settings_from(body)))

    def _refuse(self, status: HTTPStatus, message: bytes) -> None:
        self.close_connection = True
        self._send(status, message, "text/plain")

    def _answer(self, job: Job, kind: str = "application/octet-stream") -> None:
        """Send the result of a job, or its error, if the request came for this host."""
        self._has_arrived()
        # DNS rebinding: a name of another site may resolve to this machine, but its pages must not read our answers.
        if self.headers.get("Host") not in self.server.names:
            self._send(HTTPStatus.FORBIDDEN, b"the host must be this viewer's own, got another", "text/plain")
            return
        # Browsers say where a request comes from. A link on another site may open the page, but not fetch its data.
        is_link = self.path == "/" and self.headers.get("Sec-Fetch-Mode") == "navigate"
        if self.headers.get("Sec-Fetch-Site", "none") not in ("same-origin", "none") and not is_link:
            self._send(HTTPStatus.FORBIDDEN, b"the request must come from this viewer's own page", "text/plain")
            return
        try:
            self._send(HTTPStatus.OK, self.server.run_job(job), kind)
        except LidarSceneError as error:
            # A setting may hold half of a surrogate pair, which UTF-8 has no bytes for.
            message = str(error).encode(errors="backslashreplace")
            self._send(HTTPStatus.BAD_REQUEST, message, "text/plain; charset=utf-8")
        except Exception:
            self._send(HTTPStatus.INTERNAL_SERVER_ERROR, b"this failed; the terminal says why", "text/plain")
            raise

    def _send(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        """Send one response; ignore a closed connection."""
        try:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)
        except (ConnectionError, TimeoutError):  # the page was closed meanwhile, or takes nothing
            self.close_connection = True

    def log_message(self, format: str, *arguments: object) -> None:
        """Log nothing: the terminal belongs to the user."""
