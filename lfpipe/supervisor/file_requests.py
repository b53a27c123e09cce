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


@attrs.define(eq=False)
class FileRequest:
    """client: who asked, b"" for nobody. connection: the client's, -1 for none. shown: the session shows the scene already; the
    packer goes on with its disparity. reported: the packer's step in the last report, which was at report_ns."""

    client: bytes
    message: dict[str, Any]
    worker: Worker
    connection: int = -1
    shown: bool = False
    reported: str = ""
    report_ns: int = 0


class FileRequests:
    """The running children. report: receives the packer's progress a few times a second, and step "" at its end. Never blocks."""

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

    def cancel_abandoned(self, connections: set[int]) -> None:
        """Ends the requests of clients that are not among these connections any more."""
        for request in list(self._running):
            if request.connection not in connections and not request.shown:
                logger.info("%s cancelled: its client is gone", request.message["cmd"])
                self.end(request)

    def serve(self) -> Iterator[FileRequest]:
        """Requests with news: the views of a scene are ready, or the child is done."""
        for request in list(self._running):
            worker, t_ns = request.worker, now_ns()
            worker.read()
            packing = worker if isinstance(worker, Packing) else None
            if packing and packing.step != request.reported and t_ns >= request.report_ns + STEP_NS:
                request.report_ns = t_ns
                self._tell(request, packing.step, packing.share)
            if worker.done or (packing and packing.views is not None and not request.shown):
                yield request

    def _tell(self, request: FileRequest, step: str, share: float) -> None:
        request.reported = step
        name = Path(request.worker.subject).name[:MAX_NAME_CHARS]
        self._report({"scene": name, "step": step, "share": share, "shown": request.shown})

    def end(self, request: FileRequest) -> None:
        """Ends a child and forgets it."""
        if request in self._running:
            self._running.remove(request)
            request.worker.close()
            if request.reported:
                self._tell(request, "", 1.0)

    def end_shown(self) -> None:
        """Ends the packers of scenes that the session has left: the next opening completes their packs."""
        for request in [request for request in self._running if request.shown]:
            self.end(request)

    def close(self) -> None:
        """Ends all."""
        for request in self._running:
            request.worker.close()
