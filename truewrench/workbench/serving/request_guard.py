"""Who may talk to the workbench: this machine's browser, at this address, with the token; nobody else."""

from __future__ import annotations

from dataclasses import dataclass
from hmac import compare_digest
from urllib.parse import urlsplit

from tornado.httputil import HTTPServerRequest

NAMES = ("127.0.0.1", "localhost")
"""What this machine is called in an address; another name is another site's, pointed here."""


@dataclass(frozen=True)
class RequestGuard:
    """Checks of every request, a websocket's too, before anything else looks at it."""

    port: int
    token: str

    @property
    def hosts(self) -> tuple[str, ...]:
        """Host headers that are ours."""
        return tuple(f"{name}:{self.port}" for name in NAMES)

    def refusal(self, request: HTTPServerRequest) -> tuple[int, str] | None:
        """Status and reason of a request that is refused, else None."""
        if request.headers.get_list("Host") not in [[host] for host in self.hosts]:
            return 403, "foreign Host"
        origins = request.headers.get_list("Origin")
        if any(not self._is_ours(origin) for origin in origins):
            return 403, "foreign Origin"
        if self._is_of_another_site(request):
            return 403, "request of another site"
        if not self._has_token(request.path):
            return 403, "the address lacks the token; open the one that truewrench workbench printed"
        return None

    def _is_of_another_site(self, request: HTTPServerRequest) -> bool:
        """Whether the browser says so; a link in another page, such as a terminal's, may open ours with the token."""
        site, mode = (request.headers.get(f"Sec-Fetch-{name}", "") for name in ("Site", "Mode"))
        return site not in ("", "none", "same-origin") and not (mode == "navigate" and request.method == "GET")

    def _is_ours(self, origin: str) -> bool:
        parts = urlsplit(origin)
        return parts.scheme == "http" and parts.netloc in self.hosts

    def _has_token(self, path: str) -> bool:
        given = path.split("/")[1] if path.startswith("/") else ""
        return compare_digest(given.encode(), self.token.encode())
