"""Checks of paths and hosts by a child process, `python -m lfpipe.supervisor.file_checks`: a dead
network drive or name server blocks the process that asks it.
"""

import logging
from collections.abc import Collection, Mapping
from pathlib import Path

import attrs

from lfpipe.errors import UserError
from lfpipe.host.worker import Report, Worker, serve
from lfpipe.plugins import REQUESTS, guarded, load
from lfpipe.supervisor.control_sockets import Request
from lfpipe.transport.control import Message

logger = logging.getLogger(__name__)
CHECK_S = 10.0  # time limit of a check: a network drive or name server may be dead
# of a check: the libraries of a recording reserve 300 MB when they are imported
MEMORY_BYTES = 1 << 30


@attrs.frozen(kw_only=True)
class FileCheck:
    """What is checked for a request."""

    check: str  # "trace", "record", or a command of another package
    path: str  # of the output; for messages in any case
    source: str = ""  # of frames: an input, which no output may replace
    record: str = ""  # folder of the running recording, likewise
    # for a command of another package
    values: Mapping[str, tuple[str, ...]] = attrs.field(factory=dict)


class FileChecks:
    """The running checks, at most one of each command."""

    def __init__(self) -> None:
        self._running: dict[str, tuple[Request, Worker]] = {}

    def begin(self, request: Request, check: FileCheck) -> None:
        """Starts a check. Raises UserError if another one of that command runs."""
        if request.command in self._running:
            raise UserError(
                f"another {request.command} request is being checked", "try again in a second"
            )
        worker = Worker("lfpipe.supervisor.file_checks", attrs.asdict(check), check.path, CHECK_S)
        self._running[request.command] = request, worker

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [fd for _, worker in self._running.values() for fd in worker.fds]

    def update(self, connections: Collection[int]) -> list[tuple[Request, Worker]]:
        """Reads what the children have printed; returns those that are done. Ends the checks of
        clients that are not among these connections any more.
        """
        done = []
        for command, (request, worker) in list(self._running.items()):
            worker.read()
            if request.connection not in connections:
                logger.info("%s cancelled: its client is gone", command)
                worker.close()
            elif worker.done:
                done.append((request, worker))
            else:
                continue
            del self._running[command]
        return done

    def close(self) -> None:
        """Ends the children."""
        for _, worker in self._running.values():
            worker.close()
        self._running.clear()


def check(request: Message, _report: Report) -> Message:
    """In the child: the result of a FileCheck as plain values. Raises UserError."""
    asked = FileCheck(**request)
    if asked.check == "trace":
        from lfpipe.capture.spec import source_file
        from lfpipe.files.output import check_output

        inputs = (source_file(asked.source), Path(asked.record) if asked.record else None)
        check_output(Path(asked.path), [source for source in inputs if source is not None])
        return {}
    if asked.check == "record":
        from lfpipe.sequence.folder import check_out

        check_out(Path(asked.path))
        return {}
    plugin = guarded(load(REQUESTS, asked.check, ()), REQUESTS, asked.check, {"check": dict})
    return dict(plugin.check(asked))


if __name__ == "__main__":
    serve(check, MEMORY_BYTES)
