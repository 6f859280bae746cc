"""The page and what it asks for, over HTTP, for this machine alone.

Any web page that is open in the same browser could send requests to a server on loopback. Three checks refuse them:
all addresses begin with a secret that only the printed URL holds; the Host header has to be this server's, so that no
foreign name can be made to point here; and a write has to be JSON, from this origin.
"""

from __future__ import annotations

import hmac
import json
import secrets
import sys
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any, NamedTuple

from epiprior.errors import EpipriorError, SettingsError
from epiprior_lab.labels.by_hand.session import ConflictError, LabelSession

LARGEST_BODY = 1_000_000
_ADDRESS = "127.0.0.1"
_SCRIPTS = ("list.js", "main.js", "pairs.js", "pane.js", "server.js")
_PAGE = {"": "html", "label.css": "css"} | dict.fromkeys(_SCRIPTS, "javascript")
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class _Answer(NamedTuple):
    """What is sent; after the last one the server ends."""

    status: HTTPStatus
    content_type: str
    body: bytes
    last: bool = False


class _RequestError(Exception):
    def __init__(self, status: HTTPStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


def _json(value: Any, status: HTTPStatus = HTTPStatus.OK) -> _Answer:
    return _Answer(status, "application/json", json.dumps(value, allow_nan=False).encode())


class LabelServer(ThreadingHTTPServer):
    """Serves one session's page on 127.0.0.1; a context manager that closes its port.

    Port 0 takes a free one; SettingsError if a port is out of range or taken.
    """

    daemon_threads = True  # a browser opens connections ahead of need: the end does not wait for these

    def __init__(self, session: LabelSession, port: int = 0) -> None:
        self.session, self.secret = session, secrets.token_urlsafe(24)
        if not 0 <= port <= 65535:
            raise SettingsError(f"port = {port}, expected 0 to 65535")
        try:
            super().__init__((_ADDRESS, port), _Handler)
        except OSError as error:
            raise SettingsError(f"port = {port}: cannot be used: {error.strerror}") from error

    @property
    def url(self) -> str:
        """The address of the page, secret included."""
        return f"http://{_ADDRESS}:{self.server_port}/{self.secret}/"

    def serve(self) -> None:
        """Answer requests until the page says that it is done, or `shutdown` is called from another thread."""
        self.serve_forever(poll_interval=0.05)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that closed the connection in the middle of an answer."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: LabelServer
    protocol_version = "HTTP/1.0"  # a connection per request: nothing is left open when the server ends
    timeout = 20
    server_version = "epiprior-lab"
    sys_version = ""

    def _answer(self) -> _Answer:
        port, prefix = self.server.server_port, f"/{self.server.secret}/"
        if self.headers.get("Host") not in (f"{_ADDRESS}:{port}", f"localhost:{port}"):
            raise _RequestError(HTTPStatus.FORBIDDEN, "this server answers to its own name only")
        if not hmac.compare_digest(self.path[: len(prefix)].encode(), prefix.encode()):
            raise _RequestError(HTTPStatus.FORBIDDEN, "wrong token: use the address that the command printed")
        route = self.path[len(prefix) :].partition("?")[0]
        return self._get(route) if self.command == "GET" else self._post(route)

    def _get(self, route: str) -> _Answer:
        if route in _PAGE:
            data = (resources.files("epiprior_lab.labels.by_hand") / "page" / (route or "index.html")).read_bytes()
            return _Answer(HTTPStatus.OK, f"text/{_PAGE[route]}; charset=utf-8", data)
        if route in ("image/1", "image/2"):
            return _Answer(HTTPStatus.OK, "image/png", self.server.session.images[int(route[-1]) - 1].png)
        if route == "state":
            return _json(self.server.session.state())
        raise _RequestError(HTTPStatus.NOT_FOUND, "no such page")

    def _post(self, route: str) -> _Answer:
        if route not in ("fit", "save", "done"):
            raise _RequestError(HTTPStatus.NOT_FOUND, "no such page")
        if self.headers.get("Origin", f"http://{self.headers['Host']}") != f"http://{self.headers['Host']}":
            raise _RequestError(HTTPStatus.FORBIDDEN, "another page's request")
        sent, session = self.sent_json(), self.server.session
        if route == "fit":
            return _json(session.fit(sent.get("points")))
        if route == "save":
            return _json({"revision": session.save(sent.get("points"), sent.get("revision"))})
        return _json({"count": session.count()})._replace(last=True)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: addresses hold the secret."""

    def sent_json(self) -> dict[str, Any]:
        """Return the JSON object in the request's body."""
        if self.headers.get_content_type() != "application/json":
            raise _RequestError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "expected application/json")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()):
            raise _RequestError(HTTPStatus.LENGTH_REQUIRED, "expected a Content-Length")
        if len(length) > 12 or int(length) > LARGEST_BODY:
            raise _RequestError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"more than {LARGEST_BODY} bytes")
        try:
            sent = json.loads(self.rfile.read(int(length)), parse_constant=_no_constant)
        except (ValueError, RecursionError) as error:
            raise _RequestError(HTTPStatus.BAD_REQUEST, f"not JSON: {error}") from error
        if not isinstance(sent, dict):
            raise _RequestError(HTTPStatus.BAD_REQUEST, "expected a JSON object")
        return sent

    def do_GET(self) -> None:
        try:
            answer = self._answer()
        except (_RequestError, OSError, EpipriorError) as error:
            answer = _json({"error": str(error)}, _status(error))
        self.send_response(answer.status)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", answer.content_type)
        self.send_header("Content-Length", str(len(answer.body)))
        self.end_headers()
        self.wfile.write(answer.body)
        if answer.last:
            self.server.shutdown()

    do_POST = do_GET


def _status(error: Exception) -> HTTPStatus:
    """Return the status that tells the page what kind of error it is."""
    if isinstance(error, _RequestError):
        return error.status
    if isinstance(error, ConflictError):
        return HTTPStatus.CONFLICT
    # An OSError (OutputError too) is not the request's fault.
    return HTTPStatus.INTERNAL_SERVER_ERROR if isinstance(error, OSError) else HTTPStatus.UNPROCESSABLE_ENTITY


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no number")
