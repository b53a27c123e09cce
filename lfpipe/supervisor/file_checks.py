"""Work with files and names in a child process, `python -m lfpipe.supervisor.file_checks`: a dead
network drive or name server blocks the process that asks it. The child checks paths and hosts, and
writes what a person wants to keep.
"""

import logging
from collections import deque
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import UserError
from lfpipe.host.worker import Report, Worker, serve
from lfpipe.plugins import REQUESTS, guarded, load
from lfpipe.supervisor.control_sockets import Request
from lfpipe.transport.control import Message

FIX_SETTINGS = "make that file writable; if it is damaged, correct it or remove it"
logger = logging.getLogger(__name__)
CHECK_S = 10.0  # time limit of a check: a network drive or name server may be dead
# of a check: the libraries of a recording reserve 300 MB when they are imported
MEMORY_BYTES = 1 << 30
MAX_WAITING = 16  # requests to write, one after the other


@attrs.frozen(kw_only=True)
class FileCheck:
    """What the child does for a request."""

    # "trace", "record", "keep", "keep depth", or a command of another package
    check: str
    # of the output, the settings or the pack; messages name it
    path: str
    # the source of frames: an input, which no output may replace
    source: str = ""
    # the folder of the running recording, likewise
    record: str = ""
    # settings to write to [section]
    section: str = ""
    # settings, or what a command of another package has checked
    values: Mapping[str, Any] = attrs.field(factory=dict)

    @property
    def writes(self) -> bool:
        """Whether it writes a file: such work waits for its turn instead of being refused."""
        return self.check in ("keep", "keep depth")


@attrs.frozen
class CheckEvent:
    """The end of a check."""

    request: Request
    # what the child found, or why it refused
    result: Message | Exception


class FileChecks:
    """The running checks, at most one of each command."""

    def __init__(self) -> None:
        self._running: dict[str, tuple[Request, Worker]] = {}
        self._waiting: deque[tuple[Request, FileCheck]] = deque()

    def begin(self, request: Request, check: FileCheck) -> None:
        """Starts a check. Raises UserError if another one of that command runs."""
        if request.command not in self._running:
            self._start(request, check)
        elif check.writes and len(self._waiting) < MAX_WAITING:
            self._waiting.append((request, check))
        else:
            raise UserError(
                f"another {request.command} request is being checked", "try again in a second"
            )

    def _start(self, request: Request, check: FileCheck) -> None:
        worker = Worker("lfpipe.supervisor.file_checks", attrs.asdict(check), check.path, CHECK_S)
        self._running[request.command] = request, worker

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [fd for _, worker in self._running.values() for fd in worker.fds]

    def update(self, connections: Collection[int]) -> list[CheckEvent]:
        """Reads what the children have printed; returns the checks that are done. Ends the checks
        of clients that are not among these connections any more, except writes.
        """
        done = []
        for command, (request, worker) in list(self._running.items()):
            worker.read()
            if worker.done:
                done.append(_ended(request, worker))
            elif request.connection not in connections and command != "keep":
                logger.info("%s cancelled: its client is gone", command)
                worker.close()
            else:
                continue
            del self._running[command]
        if self._waiting and self._waiting[0][0].command not in self._running:
            request, check = self._waiting.popleft()
            try:
                self._start(request, check)
            except UserError as error:
                done.append(CheckEvent(request, error))
        return done

    def close(self) -> None:
        """Ends the children."""
        for _, worker in self._running.values():
            worker.close()
        self._running.clear()


def _ended(request: Request, worker: Worker) -> CheckEvent:
    try:
        return CheckEvent(request, worker.result())
    except UserError as error:
        return CheckEvent(request, error)


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
    if asked.check == "keep":
        from lfpipe.config.user_files import write_keys

        try:
            write_keys(Path(asked.path), asked.section, asked.values)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise UserError(f"{asked.path}: not saved: {why}", FIX_SETTINGS) from None
        return {}
    if asked.check == "keep depth":
        from lfpipe.scene.inverted_depth import remember
        from lfpipe.scene.pack import open_pack

        remember(open_pack(Path(asked.path)), asked.values["depth"])
        return {}
    plugin = guarded(load(REQUESTS, asked.check, ()), REQUESTS, asked.check, {"check": dict})
    return dict(plugin.check(asked))


if __name__ == "__main__":
    serve(check, MEMORY_BYTES)
