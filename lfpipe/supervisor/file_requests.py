"""Requests that wait for a child process which looks at files and hosts: a dead network drive or name server blocks who asks it.
The child is the packer at work on a scene, or a check of paths and targets, `python -m lfpipe.supervisor.file_requests`.
"""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs

from lfpipe.host.worker import Report, Worker, serve
from lfpipe.scene.open_scene import Packing
from lfpipe.transport.clock import SECOND_NS, now_ns

logger = logging.getLogger(__name__)
STEP_NS = SECOND_NS // 5  # between two reports of progress
MAX_NAME_CHARS = 200
CHECK_S = 10.0  # time limit of a check: a network drive or name server may be dead
MEMORY_BYTES = 1 << 30  # of a check: the libraries of a recording reserve 300 MB when they are imported


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

    @property
    def views(self) -> dict[str, Any] | None:
        """The scene that the packer has just made ready to be shown, if any."""
        ready = isinstance(self.worker, Packing) and not self.shown and self.worker.views
        return attrs.asdict(ready) if ready else None


class FileRequests:
    """The running children. report: receives the packer's progress a few times a second, and step "" at its end. Never blocks."""

    def __init__(self, report: Callable[[dict[str, Any]], None]) -> None:
        self._report = report
        self.running: list[FileRequest] = []

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [fd for request in self.running for fd in request.worker.fds]

    def unanswered(self, command: str) -> list[FileRequest]:
        """Requests of a command that have no answer yet."""
        return [request for request in self.running if request.message["cmd"] == command and not request.shown]

    def update(self, connections: set[int]) -> list[FileRequest]:
        """Reads what the children have printed, and ends the requests of clients that are not among these connections any more.
        Returns those with news: the views of a scene are ready, or the child is done."""
        for request in list(self.running):
            if request.connection not in connections and not request.shown:
                logger.info("%s cancelled: its client is gone", request.message["cmd"])
                self.end(request)
        for request in self.running:
            worker = request.worker
            worker.read()
            if isinstance(worker, Packing) and worker.step != request.reported and now_ns() >= request.report_ns + STEP_NS:
                request.report_ns = now_ns()
                self._tell(request, worker.step, worker.share)
        return [request for request in self.running if request.worker.done or request.views is not None]

    def _tell(self, request: FileRequest, step: str, share: float) -> None:
        request.reported = step
        name = Path(request.worker.subject).name[:MAX_NAME_CHARS]
        self._report({"scene": name, "step": step, "share": share, "shown": request.shown})

    def end(self, *requests: FileRequest) -> None:
        """Ends children and forgets them."""
        for request in requests:
            self.running.remove(request)
            request.worker.close()
            if request.reported:
                self._tell(request, "", 1.0)

    def end_shown(self) -> None:
        """Ends the packers of scenes that the session has left: the next opening completes their packs."""
        self.end(*(request for request in self.running if request.shown))


def check(request: dict[str, Any], _report: Report) -> dict[str, Any]:
    """In the child: the result of {"check": "trace", "record" or "share", ...}, as `requests` asks. Raises UserError."""
    if request["check"] == "trace":
        from lfpipe.capture.spec import source_file
        from lfpipe.files.output import check_output

        inputs = (source_file(request["source"]), Path(request["record"]) if request["record"] else None)
        check_output(Path(request["path"]), [source for source in inputs if source is not None])
        return {}
    if request["check"] == "record":
        from lfpipe.sequence.folder import check_out

        check_out(Path(request["path"]))
        return {}
    from lfpipe.share.target import check_targets

    return {"targets": list(check_targets(request["targets"], request["running"]))}


if __name__ == "__main__":
    serve(check, MEMORY_BYTES)
