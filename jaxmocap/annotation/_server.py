"""A small HTTP server for one page on this machine: who may ask, and the forms of question and answer."""

import json
import secrets
import threading
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from jaxmocap._results import InputError

HOST = "127.0.0.1"
_LARGEST = 4096  # bytes of a question
_PORTS = 20
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Answer(NamedTuple):
    """What the server gives back."""

    content: bytes
    kind: str = "application/json"
    headers: Mapping[str, str] = {}


class Refused(Exception):
    """A question that cannot be answered: HTTP status and a sentence."""

    def __init__(self, status: int, sentence: str):
        super().__init__(sentence)
        self.status = status


Routes = Mapping[tuple[str, str], Callable[[Mapping[str, Any]], Answer]]
"""(method, name) -> what to do with the fields of a question. Names are looked up here; none is ever a path."""


def json_answer(value: Any) -> Answer:
    """Answer with a value as JSON."""
    return Answer(json.dumps(value, allow_nan=False).encode())


class LocalServer:
    """Serves `routes` on the loopback address at once, to whoever knows the token that is part of the address.

    Where `port` is taken the next free one is used; 0 takes any. The name that the browser used, the token and the
    origin are checked before anything else, so that neither other machines nor other pages in the same browser get an
    answer.
    Raises `InputError` if no port is free.
    """

    def __init__(self, routes: Routes, port: int):
        self.token = secrets.token_urlsafe(24)
        self._server = _listen(port, _handler(routes, self.token))
        threading.Thread(target=self._server.serve_forever, args=(0.05,), name="annotate", daemon=True).start()

    @property
    def url(self) -> str:
        """Address of the page, with the token."""
        return f"http://{HOST}:{self._server.server_address[1]}/{self.token}/"

    def stop(self) -> None:
        """Stop answering."""
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = False


def _listen(port: int, handler: type[BaseHTTPRequestHandler]) -> _Server:
    for candidate in range(port, min(port + (_PORTS if port else 1), 65536)):
        try:
            return _Server((HOST, candidate), handler)
        except OSError:
            continue
    raise InputError(f"no port from {port} to {min(port + _PORTS, 65536) - 1} is free; give another with --port.")


def _handler(routes: Routes, token: str) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        server_version, sys_version, timeout = "jaxmocap", "", 30

        def do_GET(self) -> None:
            self._reply("GET")

        def do_POST(self) -> None:
            self._reply("POST")

        def log_message(self, format: str, *args: Any) -> None:
            """Log nothing: addresses hold the token."""

        def _reply(self, method: str) -> None:
            try:
                self._send(200, self._answer(method))
            except Refused as refused:
                self._send(refused.status, json_answer({"error": str(refused)}))
            except InputError as error:
                self._send(409, json_answer({"error": str(error)}))
            except (BrokenPipeError, ConnectionResetError):
                pass  # the page was left

        def _answer(self, method: str) -> Answer:
            address = f"{self.server.server_address[1]}"  # pyright: ignore[reportIndexIssue]
            hosts = {f"{HOST}:{address}", f"localhost:{address}"}
            if self.headers.get("Host") not in hosts:
                raise Refused(403, "this page is for this machine alone")
            first, slash, name = urlsplit(self.path).path.removeprefix("/").partition("/")
            if not secrets.compare_digest(first.encode(), token.encode()):
                raise Refused(403, "the address is not complete; open the one that jaxmocap printed")
            if self.headers.get("Origin", f"http://{HOST}:{address}") not in {f"http://{host}" for host in hosts}:
                raise Refused(403, "another page asked")
            route = routes.get((method, name)) if slash else None
            if route is None:
                raise Refused(404, "there is nothing of this name")
            return route(self._query() if method == "GET" else self._body())

        def _query(self) -> Mapping[str, Any]:
            try:
                return {name: _number(values[-1]) for name, values in parse_qs(urlsplit(self.path).query).items()}
            except ValueError:
                raise Refused(400, "numbers were expected") from None

        def _body(self) -> Mapping[str, Any]:
            if self.headers.get_content_type() != "application/json":
                raise Refused(415, "application/json was expected")
            length = self.headers.get("Content-Length", "")
            if not length.isascii() or not length.isdigit():
                raise Refused(411, "Content-Length was expected")
            if int(length) > _LARGEST:
                raise Refused(413, f"at most {_LARGEST} bytes were expected")
            try:
                found = json.loads(self.rfile.read(int(length)))
            except (ValueError, RecursionError):
                raise Refused(400, "this is not JSON") from None
            if not isinstance(found, dict):
                raise Refused(400, "an object was expected")
            return found

        def _send(self, status: int, answer: Answer) -> None:
            self.send_response(status)
            for name, value in {**_HEADERS, **answer.headers}.items():
                self.send_header(name, value)
            self.send_header("Content-Type", answer.kind)
            self.send_header("Content-Length", str(len(answer.content)))
            self.end_headers()
            self.wfile.write(answer.content)

    return Handler


def _number(text: str) -> int | float:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else float(text)
