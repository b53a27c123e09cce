"""Requests that wait for a child process which reads files: checks of paths, and the packer at work on a scene."""

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs

from lfpipe.host.worker import Worker
from lfpipe.scene.open_scene import Packing
from lfpipe.transport.clock import SECOND_NS, now_ns

logger = logging.getLogger(__name__)
STEP_NS = SECOND_NS // 5  # between two reports of progress
MAX_NAME_CHARS = 200
CHECK_S = 10.0  # time limit of a check


class FileCheck(Worker):
    """A child that checks paths and hosts; a dead network drive or name server blocks only that."""

    def __init__(self, request: dict[str, Any]) -> None:
        super().__init__("lfpipe.supervisor.file_check", request, request["path"], CHECK_S)


@attrs.define(eq=False)
class FileRequest:
    """client: who asked, b"" for nobody. connection: the client's, -1 for none. shown: the session shows the scene already; the
    packer goes on with its disparity."""

    client: bytes
    message: dict[str, Any]
    worker: Worker
    connection: int = -1
    shown: bool = False
    _report_ns: int = 0
    _step: str = ""

    def progress(self) -> dict[str, Any] | None:
        """The packer's step for those who look at the session, a few times a second; None if there is nothing to report."""
        worker, t_ns = self.worker, now_ns()
        if not isinstance(worker, Packing) or worker.step == self._step or t_ns < self._report_ns:
            return None
        self._step, self._report_ns = worker.step, t_ns + STEP_NS
        return self._message(worker.step, worker.share)

    def end(self) -> dict[str, Any] | None:
        """Ends the child; returns the last progress, if there was any."""
        self.worker.close()
        return self._message("", 1.0) if self._step else None

    def _message(self, step: str, share: float) -> dict[str, Any]:
        return {"scene": Path(self.worker.subject).name[:MAX_NAME_CHARS], "step": step, "share": share, "shown": self.shown}


class FileRequests:
    """The running children. report: receives progress. Never blocks."""

    def __init__(self, report: Callable[[dict[str, Any]], None]) -> None:
        self._report = report
        self._running: list[FileRequest] = []

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [fd for request in self._running for fd in request.worker.fds]

    def running(self, command: str) -> list[FileRequest]:
        """Requests of a command that have no answer yet."""
        return [request for request in self._running if request.message["cmd"] == command and not request.shown]

    def add(self, request: FileRequest) -> None:
        """Follows another child."""
        self._running.append(request)

    def cancel(self, gone: set[int]) -> None:
        """Ends what the clients of these connections waited for."""
        for request in [each for each in self._running if each.connection in gone and not each.shown]:
            logger.info("%s cancelled: its client is gone", request.message["cmd"])
            self.end(request)

    def serve(self) -> Iterator[FileRequest]:
        """Requests with news: the views of a scene are ready, or the child is done."""
        for request in list(self._running):
            worker = request.worker
            worker.read()
            if (progress := request.progress()) is not None:
                self._report(progress)
            if worker.done or (isinstance(worker, Packing) and worker.views is not None and not request.shown):
                yield request

    def end(self, request: FileRequest) -> None:
        """Ends a child and forgets it."""
        if request in self._running:
            self._running.remove(request)
            if (last := request.end()) is not None:
                self._report(last)

    def end_shown(self) -> None:
        """Ends the packers of scenes that the session has left: the next opening completes their packs."""
        for request in [request for request in self._running if request.shown]:
            self.end(request)

    def close(self) -> None:
        """Ends all."""
        for request in self._running:
            request.worker.close()
