"""Server of the workbench: on this machine alone, a page of its own for every tab, bounded in number."""

from __future__ import annotations

import json
import secrets
import socket
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from hmac import compare_digest
from importlib.resources import files
from logging import Filter, LogRecord, getLogger
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import unquote, urlsplit

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.core.validation import silence
from bokeh.core.validation.warnings import EMPTY_LAYOUT
from bokeh.document import Document
from bokeh.resources import Resources
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.static_handler import StaticHandler
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.web import HTTPError, RequestHandler, stream_request_body

from modeling.errors import InputError
from truewrench.options import PRESETS
from truewrench.workbench.page import Page, Start
from truewrench.workbench.page_update import PLACES
from truewrench.workbench.reading import EFFECTS
from truewrench.workbench.study_process import prepare
from truewrench.workbench.uploads import MOST_BYTES, UploadFolder

# Who may talk to the workbench: this machine's browser, at this address, with the token; nobody else.


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
        if "\0" in unquote(request.path):
            return 400, "no address holds a null character"
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


ADDRESS = "127.0.0.1"
MOST_PAGES = 12
"""Open pages: each may have a process with a recording in memory."""
CLOSED_AFTER = 15_000
"""Milliseconds after which a page whose browser is gone is closed: a reload is quicker."""
BODY_TIMEOUT = 600.0
"""Seconds for an upload."""
LARGEST_MESSAGE = 4_000_000
"""Bytes of one message of the browser: requests are short, files come another way."""


@stream_request_body
class Refusal(RequestHandler):
    """Answer to a request that is refused: status and one line, before its body is read."""

    def initialize(self, status: int, reason: str) -> None:
        self._status, self._why = status, reason

    def prepare(self) -> None:
        """Answer whatever the method."""
        self.set_status(self._status)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.set_header("Connection", "close")
        self.finish(f"{self._why}\n")

    def data_received(self, chunk: bytes) -> None:
        """Take no notice."""


@stream_request_body
class Upload(RequestHandler):
    """A file of a page: its body, as it comes, into the page's folder; never all of it in memory."""

    def initialize(self, pages: Callable[[str], UploadFolder | None]) -> None:
        self._pages = pages
        self._stream: Any = None
        self._kept = False

    def prepare(self) -> None:
        """Refuse before the body is read what has no page or no room."""
        folder = self._pages(self.request.headers.get("X-Page", ""))
        if folder is None or self.request.method != "POST":
            raise HTTPError(403)
        self._folder, self._written = folder, 0
        try:
            folder.require_room(int(self.request.headers.get("Content-Length", MOST_BYTES + 1)))
        except (InputError, ValueError) as error:
            self._refuse(error)
            return
        name = unquote(self.request.headers.get("X-Name", ""))
        self._name, self._path = folder.place(name)
        self._stream = self._path.open("wb")

    def data_received(self, chunk: bytes) -> None:
        """Write a part of the body."""
        self._written += len(chunk)
        if self._stream is not None and self._written <= MOST_BYTES:
            self._stream.write(chunk)

    async def post(self) -> None:
        """Keep the file, and say its number; archives are looked into in another thread."""
        if self._stream is None:
            return
        self._stream.close()
        self._kept = True  # whoever goes away meanwhile
        try:
            self._folder.require_room(0)
            number = await IOLoop.current().run_in_executor(None, self._folder.keep, self._path)
        except Exception as error:
            self._kept = False
            if not isinstance(error, InputError):
                raise
            self._refuse(error)
            return
        self.finish(json.dumps({"file": number, "name": self._name}))

    def on_finish(self) -> None:
        """Close the file whatever happened; one that was refused, or did not come whole, goes."""
        if self._stream is not None:
            self._stream.close()
            if not self._kept:
                self._folder.discard(self._path)

    on_connection_close = on_finish

    def _refuse(self, error: Exception) -> None:
        self.set_status(413)
        self.set_header("Connection", "close")
        self.finish(json.dumps({"wrong": str(error)}))


NO_FRAME, FRAME_OF_NOTEBOOK = "'none'", "http://localhost:* http://127.0.0.1:* vscode-webview:"
"""What may show our page in itself, which no `meta` of a page can say: nothing; notebooks of this machine."""


@cache
def _with_headers(handler: type[RequestHandler]) -> type[RequestHandler]:
    """The handler; its answers say who may show them in a frame, and no other page learns the address."""

    def set_default_headers(self: RequestHandler) -> None:
        handler.set_default_headers(self)
        application: Any = self.application
        self.set_header("Content-Security-Policy", f"frame-ancestors {application.frames}")
        self.set_header("Referrer-Policy", "no-referrer")

    return type(handler.__name__, (handler,), {"set_default_headers": set_default_headers})


class TokenHidden(Filter):
    """Filter of a log whose lines name addresses: without the token, which opens the pages to whoever reads it."""

    def __init__(self, token: str) -> None:
        super().__init__()
        self._token = token

    def filter(self, record: LogRecord) -> bool:
        """Replace the token in the message."""
        record.msg, record.args = record.getMessage().replace(self._token, "TOKEN"), ()
        return True


LOGS = ("tornado.access", "tornado.application", "tornado.general")
"""Logs that name addresses."""


class WorkbenchApplication(BokehTornado):
    """Bokeh's application behind the guard, with a bound on the number of pages."""

    guard: RequestGuard
    frames: str

    def resources(self, absolute_url: str | bool | None = None) -> Resources:
        """Only the parts of BokehJS that the page uses: it paints sooner."""
        root = f"/{self.guard.token}/"
        return Resources(
            mode="server", root_url=root, path_versioner=StaticHandler.append_version, components=["bokeh"]
        )

    def find_handler(self, request: HTTPServerRequest, **more: Any) -> Any:
        """The handler of a request, every request: refusal, or what Bokeh has for it."""
        refusal = self.guard.refusal(request)
        is_page = request.path.rstrip("/") == f"/{self.guard.token}"
        if refusal is None and is_page and len(self.get_sessions("/")) >= MOST_PAGES:
            refusal = 503, f"{MOST_PAGES} pages of the workbench are open; close one, wait half a minute, and reload"
        if refusal is not None:
            values = {"status": refusal[0], "reason": refusal[1]}
            return self.get_handler_delegate(request, Refusal, values, more.get("path_args"), more.get("path_kwargs"))
        return super().find_handler(request, **more)

    def get_handler_delegate(
        self, request: HTTPServerRequest, target_class: type[RequestHandler], *values: Any, **more: Any
    ) -> Any:
        """Of any handler, Bokeh's too, with our headers."""
        return super().get_handler_delegate(request, _with_headers(target_class), *values, **more)  # type: ignore[arg-type]


class WorkbenchServer:
    """The workbench on a port of this machine.

    Parameters
    ----------
    start : Start
        What every page opens by itself.
    port : int
        0 for any that is free.

    Raises
    ------
    InputError
        When the port is taken.
    """

    def __init__(self, start: Start, port: int = 0) -> None:
        silence(EMPTY_LAYOUT)  # a page begins without figures
        self._pages: dict[str, Page] = {}
        self._start = start
        token = secrets.token_urlsafe(24)
        for log in LOGS:
            getLogger(log).addFilter(TokenHidden(token))
        try:
            listener = socket.create_server((ADDRESS, port))
        except OSError as error:
            remedy = "give --port another number, or 0 for any that is free"
            raise InputError(what=error.strerror or "cannot be used", where=f"port {port}", remedy=remedy) from None
        listener.setblocking(False)
        self.port = int(listener.getsockname()[1])
        self.guard = RequestGuard(self.port, token)
        self._application = self._tornado()
        http = HTTPServer(
            self._application,
            max_body_size=MOST_BYTES,
            body_timeout=BODY_TIMEOUT,
            max_header_size=16_384,
            max_buffer_size=MOST_BYTES,
        )
        http.add_sockets([listener])
        self._server = BaseServer(IOLoop.current(), self._application, http)

    @property
    def address(self) -> str:
        """What the browser opens."""
        return f"http://{ADDRESS}:{self.port}/{self.guard.token}/"

    def run(self, *, prepared: bool = False) -> None:
        """Serve until interrupted; the processes of all pages end with it.

        What they and the drawing need is imported meanwhile, unless it is `prepared`.
        """
        if not prepared:
            Thread(target=_load_drawing, daemon=True).start()
            prepare()
        self._server.start()
        try:
            self._server.io_loop.start()
        finally:
            self._end()

    def stop(self) -> None:
        """Stop, from another thread."""
        self._server.io_loop.add_callback(self._server.io_loop.stop)

    def _end(self) -> None:
        for page in list(self._pages.values()):
            page.end()
        self._server.stop()

    def _tornado(self) -> WorkbenchApplication:
        extra = [("/upload", Upload, {"pages": self._uploads_of})]
        application = WorkbenchApplication.__new__(WorkbenchApplication)
        application.guard = self.guard
        application.frames = NO_FRAME if self._start.study is None else FRAME_OF_NOTEBOOK
        application.__init__(  # type: ignore[misc]  # the guard answers from the first request on
            {"/": Application(FunctionHandler(self._open))},
            prefix=self.guard.token,
            extra_websocket_origins=list(self.guard.hosts),
            extra_patterns=extra,
            use_index=False,
            redirect_root=False,
            unused_session_lifetime_milliseconds=CLOSED_AFTER,
            check_unused_sessions_milliseconds=CLOSED_AFTER // 3,
            websocket_max_message_size_bytes=LARGEST_MESSAGE,
        )
        return application

    def _uploads_of(self, page: str) -> UploadFolder | None:
        known_page = self._pages.get(page)
        return None if known_page is None else known_page.uploads

    def _open(self, document: Document) -> None:
        """A new page: its document, its folder; they go when the browser has gone."""
        page = Page(document, self._start)
        key = secrets.token_urlsafe(12)
        self._pages[key] = page
        document.title = "truewrench workbench"
        document.template = page_template()
        document.template_variables["page_key"] = key
        document.template_variables["opens"] = self._start.request is not None
        document.template_variables["of_notebook"] = self._start.study is not None
        document.on_session_destroyed(lambda _context: self._close(key))

    def _close(self, key: str) -> None:
        page = self._pages.pop(key, None)
        if page is not None:
            page.end()


@cache
def page_template() -> Any:
    """The page, with its style and script in it."""
    folder = files("truewrench.workbench") / "templates"
    environment = Environment(  # only our own text, and scripts
        loader=PackageLoader("truewrench.workbench"), undefined=StrictUndefined
    )
    parts = {name: Markup((folder / f"page.{name}").read_text(encoding="utf-8")) for name in ("css", "js")}
    environment.globals |= {
        "puzzles": EFFECTS,
        "presets": PRESETS,
        "places": PLACES.items(),
        "style": parts["css"],
        "script": parts["js"],
        "most_megabytes": MOST_BYTES // 1_000_000,
    }
    return environment.get_template("page.html")


def _load_drawing() -> None:
    """Import what draws charts, while the browser opens the page."""
    import truewrench.plots.bokeh_chart  # noqa: F401


def readable(paths: tuple[str, ...]) -> None:
    """InputError for a path that is not there, before any page is opened."""
    for path in paths:
        if not Path(path).exists():
            raise InputError(what="No such file or directory", where=path, remedy="give a recording that can be read")
