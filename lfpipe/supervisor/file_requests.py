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
MAX_NAME_CHARS = 200  # more than a window has room for
SHOWN = "shown"  # instead of a command: the scene is on the screen
CHECK_S = 10.0  # time limit of a check: a network drive or name server may be dead
MEMORY_BYTES = (
    1 << 30
)  # of a check: the libraries of a recording reserve 300 MB when they are imported


@attrs.define
class FileRequest:
    """client: who asked, b"" for nobody. connection: the client's. reported: the packer's last reported step, at report_ns."""

    client: bytes
    message: dict[str, Any]
    worker: Worker
    connection: int = -1
    reported: str = ""
    report_ns: int = 0


class FileRequests:
    """The running children. running: by the command that waits for one; SHOWN is the packer of the scene on the screen, which
    goes on with its disparity. report: receives a packer's progress a few times a second, and step "" at its end."""

    def __init__(self, report: Callable[[dict[str, Any]], None]) -> None:
        self._report = report
        self.running: dict[str, FileRequest] = {}

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [fd for request in self.running.values() for fd in request.worker.fds]

    def update(self, connections: set[int]) -> list[str]:
        """Reads what the children have printed, and ends the requests of clients that are not among these connections any more.
        Returns the commands with news: the views of a scene are ready, or the child is done."""
        for command, request in list(self.running.items()):
            if command != SHOWN and request.connection not in connections:
                logger.info("%s cancelled: its client is gone", command)
                self.end(command)
        news = []
        for command, request in self.running.items():
            worker = request.worker
            worker.read()
            if (
                isinstance(worker, Packing)
                and worker.step != request.reported
                and now_ns() >= request.report_ns + STEP_NS
            ):
                request.report_ns = now_ns()
                self._tell(command, worker.step, worker.share)
            if worker.done or (
                command == "load" and isinstance(worker, Packing) and worker.views is not None
            ):
                news.append(command)
        return news

    def _tell(self, command: str, step: str, share: float) -> None:
        request = self.running[command]
        request.reported = step
        name = Path(request.worker.subject).name[:MAX_NAME_CHARS]
        self._report({"scene": name, "step": step, "share": share, "shown": command == SHOWN})

    def end(self, command: str) -> None:
        """Ends a child, if one runs, and forgets it. That of a scene which the session has left: the next opening completes its
        pack."""
        if command in self.running:
            if self.running[command].reported:
                self._tell(command, "", 1.0)
            self.running.pop(command).worker.close()


def check(request: dict[str, Any], _report: Report) -> dict[str, Any]:
    """In the child: the result of {"check": "trace", "record" or "share", ...}, as `requests` asks. Raises UserError."""
    if request["check"] == "trace":
        from lfpipe.capture.spec import source_file
        from lfpipe.files.output import check_output

        inputs = (
            source_file(request["source"]),
            Path(request["record"]) if request["record"] else None,
        )
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
