"""HTTP proxy before a real S3 server: accepts Google's requests too, loses answers, refuses, and more."""

from __future__ import annotations

import contextlib
import http.client
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit


class FaultyProxy(ThreadingHTTPServer):
    """Proxy that forwards requests.

    lost: number of next PUTs that reach the server and get no answer. refusal: (status, code) that answers the refused
    methods, all if none is named. unconditional: drops If-None-Match. requests: methods seen.
    """

    daemon_threads = True

    def __init__(self, server: str) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.behind = urlsplit(server)
        self.lost = 0
        self.refusal: tuple[int, str] | None = None
        self.refused: tuple[str, ...] = ()
        self.unconditional = False
        self.requests: list[str] = []
        self.lock = threading.Lock()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"

    def loses(self, method: str) -> bool:
        with self.lock:
            self.requests.append(method)
            self.lost -= (lost := method == "PUT" and self.lost > 0)
            return lost


def _as_amazon(headers: dict[str, str]) -> dict[str, str]:
    """Translate Google's headers: its XML interface differs from Amazon's in these two alone."""
    if not headers.get("authorization", "").startswith("AWS4"):
        headers["authorization"] = "AWS4-HMAC-SHA256 Credential=test/20260101/us-east-1/s3/aws4_request"
    if headers.pop("x-goog-if-generation-match", None) == "0":
        headers["if-none-match"] = "*"
    return headers


class _Handler(BaseHTTPRequestHandler):
    server: FaultyProxy
    protocol_version = "HTTP/1.1"

    def _pass_on(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        lost = self.server.loses(self.command)
        if self.server.refusal and self.command in (self.server.refused or (self.command,)):
            status, code = self.server.refusal
            self._answer(status, [], f"<Error><Code>{code}</Code></Error>".encode())
            return
        headers = _as_amazon({name.lower(): value for name, value in self.headers.items()})
        if self.server.unconditional:
            headers.pop("if-none-match", None)
        behind = http.client.HTTPConnection(self.server.behind.hostname or "", self.server.behind.port)
        behind.request(self.command, self.path, body, headers)
        answer = behind.getresponse()
        content = answer.read()
        if lost:
            self.close_connection = True
            self.connection.close()
            return
        self._answer(answer.status, answer.getheaders(), content)

    def do_GET(self) -> None:
        self._pass_on()

    def do_PUT(self) -> None:
        self._pass_on()

    def do_POST(self) -> None:
        self._pass_on()

    def do_HEAD(self) -> None:
        self._pass_on()

    def do_DELETE(self) -> None:
        self._pass_on()

    def _answer(self, status: int, headers: list[tuple[str, str]], content: bytes) -> None:
        self.send_response_only(status)
        for name, value in headers:
            if name.lower() not in ("transfer-encoding", "connection", "content-length"):
                self.send_header(name, value)
        length = dict(headers).get("Content-Length", "0") if self.command == "HEAD" else str(len(content))
        self.send_header("Content-Length", length)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        pass


@contextlib.contextmanager
def faulty_proxy(server: str) -> Iterator[FaultyProxy]:
    """Run a proxy before ``server`` on a free port of loopback."""
    proxy = FaultyProxy(server)
    thread = threading.Thread(target=proxy.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield proxy
    finally:
        proxy.shutdown()
        proxy.server_close()
        thread.join()
