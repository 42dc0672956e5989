"""One page: what its browser asks for goes to its process, what comes back changes words and figures."""

from __future__ import annotations

import json
from base64 import b64encode
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from bokeh.document import Document
from bokeh.events import Tap
from bokeh.layouts import column
from bokeh.models import ColumnDataSource
from markupsafe import escape

from modeling.errors import InputError
from truewrench.plots.bokeh_chart import bokeh_chart, figures_of, legend_html
from truewrench.plots.style import DARK, LIGHT
from truewrench.workbench.page_update import with_field_names
from truewrench.workbench.study_process import (
    Cancelled,
    Done,
    Ended,
    Message,
    Progress,
    Refused,
    StudyProcess,
    StudyThread,
)
from truewrench.workbench.uploads import UploadFolder

if TYPE_CHECKING:
    from diagnosis.study import Study

ENDED = Refused("the computation ended unexpectedly", "workbench", "open the recording again")
FILES = ("recordings", "validate", "rig", "map")
"""What of a request is a file, or several."""
OPENING = ("open", "contact")
"""Requests that open files."""
LONGEST_REQUEST = 50_000
"""Characters."""
MOST_WAITING = 20
AS_IN_NOTEBOOK = 1000
"""Milliseconds after which a page shows what its notebook did."""


@dataclass(frozen=True)
class Start:
    """What a page opens by itself: paths of recordings and of a rig, as on the command line, or a notebook's study.

    A study is worked on in this process, in which the notebook has it; recordings in one of their own.
    """

    recordings: tuple[str, ...] = ()
    validate: tuple[str, ...] = ()
    rig: str | None = None
    study: Study | None = None

    @property
    def request(self) -> dict[str, Any] | None:
        """The request that opens them; None for nothing."""
        if self.study is not None:
            return {"do": "shown"}
        if not self.recordings:
            return None
        return {"do": "open", "recordings": list(self.recordings), "validate": list(self.validate), "rig": self.rig}

    def worker(self, receive: Callable[[Message], None]) -> StudyProcess | StudyThread:
        """Who answers the requests of a page."""
        return StudyProcess(receive) if self.study is None else StudyThread(receive, self.study)


@dataclass(eq=False)
class Page:
    """State of one page, which is one document of Bokeh.

    Its requests are answered one after the other. What follows by itself (the suspects) gives way to what is asked for.
    """

    document: Document
    start: Start
    uploads: UploadFolder = field(default_factory=UploadFolder)
    dark: bool = False

    def __post_init__(self) -> None:
        self._process: StudyProcess | StudyThread | None = None
        self._waiting: deque[dict[str, Any]] = deque()
        self._current: dict[str, Any] | None = None
        self._follow: dict[str, Any] | None = None
        self._shown: Any = None
        self._number = self._heard = 0
        self._ended = self._stopping = False
        self._requests = ColumnDataSource(data={"request": []}, name="requests")
        self._answers = ColumnDataSource(data={"answer": []}, name="answers")
        self._plots = column(name="plots", sizing_mode="stretch_width")
        self._requests.on_change("data", self._asked)
        for root in (self._requests, self._answers, self._plots):
            self.document.add_root(root)
        self._steps = self._steps_of_notebook
        if self.start.study is not None:
            self.document.add_periodic_callback(self._follow_notebook, AS_IN_NOTEBOOK)

    @property
    def _steps_of_notebook(self) -> object:
        return None if self.start.study is None else self.start.study.steps

    def _follow_notebook(self) -> None:
        """Show the steps that a notebook made."""
        if self._steps_of_notebook is not self._steps and self._current is None:
            self._steps = self._steps_of_notebook
            self._begin({"do": "shown"})

    # ------------------------------------------------------------------------------- from the browser

    def _asked(self, _name: str, _old: object, new: Mapping[str, Any]) -> None:
        """Requests as the browser wrote them: JSON, one a message."""
        for text in new.get("request", []):
            with suppress(ValueError, TypeError, RecursionError):
                if (
                    isinstance(text, str)
                    and len(text) <= LONGEST_REQUEST
                    and isinstance(request := json.loads(text), dict)
                ):
                    self.ask(request)

    def ask(self, request: dict[str, Any]) -> None:
        """Do what is asked, or send it to the process when it is free."""
        name = request.get("do")
        if isinstance(number := request.get("number"), int):
            self._heard = number
        if name == "ready":
            self._ready(dark=bool(request.get("dark")))
        elif name == "scheme":
            self.dark = bool(request.get("dark"))
            self._draw()
        elif name == "cancel":
            self._cancel()
        elif len(self._waiting) < MOST_WAITING:
            self._enqueue(request)

    def _ready(self, *, dark: bool) -> None:
        self.dark = dark
        if self.start.request is not None and self._process is None:
            self._begin(self.start.request)

    def _enqueue(self, request: dict[str, Any]) -> None:
        try:
            resolved = self._with_paths(request)
        except InputError as error:
            self._refuse(Refused(error.what, error.where, error.remedy))
            self._next()
            return
        if request.get("do") == "check":  # only the latest counts
            self._waiting = deque(r for r in self._waiting if r.get("do") != "check")
        self._begin(resolved)

    def _begin(self, request: dict[str, Any]) -> None:
        self._waiting.append(request)
        if self._current is not None and self._current is self._follow:
            self._stop()
        self._next()

    def _with_paths(self, request: dict[str, Any]) -> dict[str, Any]:
        """The request with the uploaded files' paths for their numbers: no other path is opened by the process."""
        resolved = dict(request)
        for name in FILES if request.get("do") in OPENING else ():
            given = request.get(name)
            if isinstance(given, list):
                resolved[name] = [self.uploads.path(str(number)) for number in given]
            elif given:
                resolved[name] = self.uploads.path(str(given))
            else:
                resolved[name] = None if name in ("rig", "map") else []
        if request.get("do") == "puzzle":
            resolved["folder"] = str(self.uploads.folder())
        return resolved

    def _next(self) -> None:
        if self._current is not None:
            return
        if not self._waiting and self._follow is not None:
            self._waiting.append(self._follow)
        if not self._waiting:
            self._say(busy=False)
            return
        self._current = self._waiting.popleft()
        if self._process is None:
            self._process = self.start.worker(self._receive)
        self._say(busy=True, progress="working", quiet=self._current is self._follow)
        try:
            self._process.ask(self._current)
        except OSError:
            self._receive(Ended())

    def _cancel(self) -> None:
        self._waiting.clear()
        self._follow = None if self._current is self._follow else self._follow
        self._stop()

    def _stop(self) -> None:
        """Cancel what is under way, once: a second signal could meet the request that comes next."""
        if self._current is not None and self._process is not None and not self._stopping:
            self._stopping = True
            self._process.cancel()

    # -------------------------------------------------------------------------------- from the process

    def _receive(self, message: Message) -> None:
        """A message of the process, in a thread of its own: the document takes it in its turn."""
        if self._ended:
            return
        with suppress(RuntimeError, AttributeError):  # the document is gone
            self.document.add_next_tick_callback(lambda: self._take(message))

    def _take(self, message: Message) -> None:
        if isinstance(message, Progress):
            self._say(progress=message.text)
            return
        was, self._current, self._stopping = self._current, None, False
        self._steps = self._steps_of_notebook
        if isinstance(message, Done):
            if was is self._follow:
                self._follow = None
            self._show(message.answer)
            if message.answer.charts:  # the words are sent before the charts are drawn
                self.document.add_next_tick_callback(self._draw_and_go_on)
                return
        elif isinstance(message, Cancelled):
            if was is not self._follow:
                self._say(notice="Cancelled; the study is as before.")
        elif isinstance(message, Refused):
            if was is self._follow:
                self._follow = None
            self._refuse(message)
        elif isinstance(message, Ended):
            self._process, self._follow = None, None
            if was is not None:
                self._refuse(ENDED)
        self._next()

    def _show(self, update: Any) -> None:
        if update.follow is not None:
            self._follow = dict(update.follow)
        elif "steps" in update.words:
            self._follow = None
        if update.download is not None:
            content = b64encode(update.download.content).decode()
            self._say(download={"name": update.download.name, "kind": update.download.kind, "content": content})
        if update.words:
            self._say(words=dict(update.words))
        if update.charts:
            self._shown = update

    def _draw_and_go_on(self) -> None:
        self._draw()
        self._next()

    def _draw(self) -> None:
        """The charts in the colours of the page."""
        if self._shown is None:
            return
        chart = self._shown.charts["plots"]
        scheme = DARK if self.dark else LIGHT
        layout = bokeh_chart(chart, scheme)
        self._say(words={"legend": legend_html(chart, scheme)})
        tap = self._shown.taps.get("plots")
        if tap is not None:
            for number, drawn in enumerate(figures_of(layout)):
                drawn.on_event(Tap, self._tapped(tap, number))
        self._plots.children = [layout]

    def _tapped(self, request: Mapping[str, Any], number: int) -> Callable[[Any], None]:
        return lambda event: self._enqueue({**request, "panel": number, "x": float(event.x)})

    def _refuse(self, message: Refused) -> None:
        where, what, remedy = (
            escape(with_field_names(self.uploads.named(t))) for t in (message.where, message.what, message.remedy)
        )
        self._say(notice=f"<b>{where}</b>: {what}; {remedy}", wrong=True)

    def _say(self, **answer: Any) -> None:
        """Tell the browser; each answer is numbered, so that none is taken for the one before.

        It says which request came last: what does not know of a later one does not say that all is done.
        """
        self._number += 1
        self._answers.data = {"answer": [json.dumps(answer | {"number": self._number, "heard": self._heard})]}

    # --------------------------------------------------------------------------------------------- end

    def end(self) -> None:
        """End the process and remove the files: the page is closed."""
        self._ended = True
        if self._process is not None:
            self._process.end()
            self._process = None
        self.uploads.remove()
