"""What any program of this machine, or a page of another site, may send to the server: in a thread, nothing traced."""

import contextlib
import json
import socket
import threading
from collections.abc import Iterator

import pytest
from helpers.mistakes import told
from helpers.waiting import PATIENCE_S, wait_until

from lidarscene.errors import InputError
from lidarscene.view import serve
from lidarscene.view.controls import Settings, number_of
from lidarscene.view.serve import HOST, Server


class Nothing:
    """A source without a scene, which counts how often it is asked."""

    title = "nothing"
    frames = ("one",)
    requests = 0

    def stage(self, number: int | None = None) -> bytes:
        return b"stage"

    def frame(self, number: int) -> bytes:
        return b"frame"

    def render(self, settings: Settings) -> bytes:
        self.requests += 1
        return json.dumps(dict(settings)).encode()


@contextlib.contextmanager
def running_server() -> Iterator[Server]:
    with Server(0) as server:
        thread = threading.Thread(target=server.serve, args=(Nothing(),))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def shared_server() -> Iterator[Server]:
    with running_server() as server:
        yield server


@pytest.fixture
def server(shared_server: Server) -> Server:
    shared_server.source = Nothing()
    return shared_server


@pytest.fixture
def impatient(server: Server, monkeypatch: pytest.MonkeyPatch) -> Server:
    """One that waits for a fifth of a second."""
    monkeypatch.setattr(serve, "PATIENCE_S", 0.2)
    monkeypatch.setattr(serve._Handler, "timeout", 0.2)
    return server


def answer_to(server: Server, request: bytes, *, ends: bool = False) -> bytes:
    """All that comes back; ``ends``: nothing more is sent, which the server sees."""
    with socket.create_connection((HOST, server.server_port), timeout=PATIENCE_S) as connection:
        connection.sendall(request)
        if ends:
            connection.shutdown(socket.SHUT_WR)
        answer = b""
        with contextlib.suppress(ConnectionError):
            while part := connection.recv(65536):
                answer += part
    return answer


def post(server: Server, body: bytes, *headers: str, length: str | None = None) -> bytes:
    lines = ["POST /render HTTP/1.1", f"Host: {HOST}:{server.server_port}", "Connection: close", *headers]
    lines.append(f"Content-Length: {len(body) if length is None else length}")
    return answer_to(server, "\r\n".join([*lines, "", ""]).encode() + body, ends=True)


def status(answer: bytes) -> int:
    return int(answer.split()[1])


@pytest.mark.parametrize("origin", ["https://evil.example", "null", "http://127.0.0.1:1", ""])
def test_posts_of_other_origins_are_refused(server: Server, origin: str) -> None:
    """Rationale: a form of any site can send a request to this machine, and each costs a frame."""
    assert status(post(server, b"{}", f"Origin: {origin}")) == 403
    assert server.source.requests == 0
    assert status(post(server, b"{}", f"Origin: http://localhost:{server.server_port}")) == 200
    assert status(post(server, b"{}")) == 200  # other programs than browsers send none


@pytest.mark.parametrize(
    ("body", "length", "expected"),
    [
        (b"{}", "-1", 400),
        (b"{}", "x", 400),
        (b"{}", "", 400),
        (b"{}", "2, 2", 400),
        (b"{}", "9" * 5000, 400),
        (b"{}", "70000", 413),
        (b"{}", "3", 400),
        (b"no", None, 400),
        (b"[1]", None, 400),
        (b"\xff\xfe", None, 400),
        (b"[" * 30_000, None, 400),
        (b'{"a":' * 10_000, None, 400),
        (b"", None, 400),
    ],
)
def test_malformed_bodies(server, body, length, expected, capsys):
    answer = post(server, body, length=length)
    assert status(answer) == expected
    assert server.source.requests == 0
    assert len(answer) < 2000
    assert capsys.readouterr().err == ""


def test_two_lengths_and_chunks(server: Server) -> None:
    assert status(post(server, b"{}", "Content-Length: 2")) == 400
    assert status(post(server, b"{}", "Transfer-Encoding: chunked")) == 400


@pytest.mark.parametrize("value", [10**400, -(10**400), "x" * 20_000, float("nan"), None, [], True])
def test_numbers_that_are_none(value: object) -> None:
    with told("detector.gain | number"):
        number_of("detector.gain", value)


@pytest.mark.parametrize("path", ["/frame-" + "9" * 5000, "/frame-1", "/frame--1", "/%00", "/frame-"])
def test_other_paths(server: Server, path: str, capsys: pytest.CaptureFixture[str]) -> None:
    request = f"GET {path} HTTP/1.1\r\nHost: {HOST}:{server.server_port}\r\nConnection: close\r\n\r\n"
    assert status(answer_to(server, request.encode())) == 404
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("request_line", [b"GET / HTTP/1.1", b"GET /none HTTP/1.1", b"BREW / HTTP/1.1"])
def test_headers_of_every_answer(server: Server, request_line: bytes) -> None:
    host = f"\r\nHost: {HOST}:{server.server_port}\r\nConnection: close\r\n\r\n".encode()
    answer = answer_to(server, request_line + host)
    for header in (b"X-Content-Type-Options: nosniff\r\n", b"frame-ancestors 'none'\r\n"):
        assert header in answer


@pytest.mark.parametrize("half", [b"", b"GE", b"GET / HTTP/1.1\r\nHost: x\r\nA: "])
def test_half_a_request_is_hung_up_on(impatient: Server, half: bytes) -> None:
    """Rationale: else each holds a thread for ever."""
    assert answer_to(impatient, half) == b""
    lines = f"POST /render HTTP/1.1\r\nHost: {HOST}:{impatient.server_port}\r\nContent-Length: 9\r\n\r\n{{"
    answer = answer_to(impatient, lines.encode())
    assert answer == b"" or status(answer) == 400


def test_a_request_of_single_bytes_is_too(impatient: Server) -> None:
    """Rationale: each byte is in time, and all of them never end."""
    with socket.create_connection((HOST, impatient.server_port), timeout=PATIENCE_S) as connection:
        connection.settimeout(0.05)

        def is_over() -> bool:
            try:
                connection.sendall(b"G")
                return connection.recv(1) == b""
            except TimeoutError:
                return False
            except OSError:
                return True

        wait_until(is_over)


def test_connections_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """While all are answered, one more gets 503; as soon as one is free, it is answered."""
    monkeypatch.setattr(serve, "MOST_CONNECTIONS", 3)
    with Server(0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        server.source = Nothing()
        answered, arrived = threading.Semaphore(0), []

        def held_job(job: serve.Job) -> bytes:
            arrived.append(job)
            answered.acquire()
            return job()

        monkeypatch.setattr(server, "run_job", held_job)
        page = f"GET /stage HTTP/1.1\r\nHost: {HOST}:{server.server_port}\r\nConnection: close\r\n\r\n".encode()
        held = [socket.create_connection((HOST, server.server_port)) for _ in range(3)]
        for connection in held:
            connection.sendall(page)  # its job is not run, so it is being answered
        wait_until(lambda: len(arrived) == 3)
        request = page.replace(b"/stage", b"/none")
        assert status(answer_to(server, request)) == 503
        answered.release(3)
        wait_until(lambda: status(answer_to(server, request)) == 404)
        for connection in held:
            connection.close()
        server.shutdown()


def test_half_requests_do_not_lock_others_out(server: Server) -> None:
    """Connections are as many as there may be, each with half a request: the next whole one is answered at once, not
    after 10 s.
    """
    request = f"GET /stage HTTP/1.1\r\nHost: {HOST}:{server.server_port}\r\nConnection: close\r\n\r\n".encode()
    with contextlib.ExitStack() as opened:
        for _ in range(serve.MOST_CONNECTIONS):
            held = opened.enter_context(socket.create_connection((HOST, server.server_port)))
            held.sendall(b"GET / HTTP/1.1\r\nHost: ")
        wait_until(lambda: len(server._waiting) == serve.MOST_CONNECTIONS)
        for _ in range(5):
            assert status(answer_to(server, request)) == 200


@pytest.mark.parametrize("body", [b'{"detector": "\\ud800"}', b'{"\\ud800": 1}', b'{"detector.gain": "\\udfff"}'])
def test_half_a_surrogate_pair_is_answered(server: Server, body: bytes, capsys: pytest.CaptureFixture[str]) -> None:
    def refuse(settings: Settings) -> bytes:
        raise InputError(f"settings: unknown: {next(iter(settings.values()))}{next(iter(settings))}")

    server.source.render = refuse
    answer = post(server, body)
    assert status(answer) == 400
    assert b"unknown" in answer
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("site", ["cross-site", "same-site", "x"])
def test_pages_of_other_sites_are_refused(server: Server, site: str) -> None:
    """Browsers send Sec-Fetch-Site with each request; a link on another site may open the page, nothing else."""

    def get(path: str, *headers: str) -> int:
        lines = [f"GET {path} HTTP/1.1", f"Host: {HOST}:{server.server_port}", "Connection: close", *headers]
        return status(answer_to(server, "\r\n".join([*lines, "", ""]).encode()))

    for path in ("/", "/stage", "/frame-0"):
        assert get(path, f"Sec-Fetch-Site: {site}") == 403
        assert get(path, "Sec-Fetch-Site: same-origin") == 200
        assert get(path, "Sec-Fetch-Site: none") == 200
    assert get("/", f"Sec-Fetch-Site: {site}", "Sec-Fetch-Mode: navigate") == 200
    assert get("/stage", f"Sec-Fetch-Site: {site}", "Sec-Fetch-Mode: navigate") == 403
    assert status(post(server, b"{}", f"Sec-Fetch-Site: {site}")) == 403
