"""Access control of the studio's page: this machine, its own page, and the secret address only."""

import hmac
import http
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from sarmitsuba.core.errors import SarmitsubaError

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_COOKIE = "sarmitsuba_studio"

Answer = Callable[[object, Request], Response | None]


class Guard:
    """Check of every request, also of web sockets, before the page's server.

    A request must address a loopback host (other names may be an attacker's names of this machine), originate from a
    page of that host or from none, and contain the secret: first in the address, afterwards in a cookie that is not
    sent to other sites.

    Attributes
    ----------
    token : the secret, new at every start
    """

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(24)

    def refusal(self, request: Request) -> str:
        """Reason for refusing a request; empty where it is accepted."""
        host = request.headers.get("Host", "")
        origin = request.headers.get("Origin")
        try:
            asked, page = urlsplit(f"//{host}").hostname, None if origin is None else urlsplit(origin).netloc
        except ValueError:  # not an address
            return "this host is not served"
        if asked not in LOOPBACK:
            return "this host is not served"
        if page not in (None, host):
            return "requests from other pages are refused"
        if not (self._in_address(request) or self._in_cookie(request)):
            return "open the address printed by the command"
        return ""

    def around(self, answer: Answer | None) -> Answer:
        """The server's answer, for accepted requests only."""

        def guarded(connection: object, request: Request) -> Response | None:
            reason = self.refusal(request)
            if reason:
                body = f"{reason}\n".encode()
                head = Headers({"Content-Type": "text/plain", "Content-Length": str(len(body))})
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", head, body)
            response = None if answer is None else answer(connection, request)
            if response is not None and self._in_address(request):
                response.headers["Set-Cookie"] = f"{_COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            return response

        return guarded

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Guard web socket servers started within the context; viser has no setting for it."""
        module = websockets.asyncio.server
        plain = module.serve

        def serve(*args: object, process_request: Answer | None = None, **kwargs: object) -> object:
            return plain(*args, process_request=self.around(process_request), **kwargs)  # type: ignore[arg-type]

        module.serve = serve  # type: ignore[misc,assignment]
        try:
            yield
        finally:
            module.serve = plain  # type: ignore[misc]

    def _in_address(self, request: Request) -> bool:
        given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        return hmac.compare_digest(given.encode(), self.token.encode())

    def _in_cookie(self, request: Request) -> bool:
        parts = (
            part.strip().partition("=")
            for line in request.headers.get_all("Cookie")
            for part in line.split(";")
        )
        return any(
            name == _COOKIE and hmac.compare_digest(value.encode(), self.token.encode())
            for name, _, value in parts
        )


def check_host(host: str) -> None:
    """Raise a SarmitsubaError for an address that other machines can reach."""
    if host not in LOOPBACK:
        raise SarmitsubaError(
            f"studio: --host {host} can be reached by other machines; choose one of {', '.join(LOOPBACK)}, and from "
            "elsewhere use `ssh -L 8080:127.0.0.1:8080`"
        )
