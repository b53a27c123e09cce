"""The checks of a session's files: child processes that answer requests for `file_checks`."""

import logging
from collections import deque
from collections.abc import Callable, Collection

import attrs

from lfpipe.errors import UserError
from lfpipe.host.worker import Worker
from lfpipe.supervisor.control_sockets import Request
from lfpipe.supervisor.file_checks import FileCheck
from lfpipe.transport.control import Message

logger = logging.getLogger(__name__)
CHECK_S = 10.0  # time limit of a check: a network drive or name server may be dead


@attrs.frozen
class CheckEvent:
    """The end of a check."""

    request: Request
    result: Message | Exception
    """The result of the child, or its error."""


class FileChecks:
    """The running checks, at most one per command. connections: returns the open ones."""

    def __init__(self, connections: Callable[[], Collection[int]]) -> None:
        self._connections = connections
        self._running: dict[str, tuple[Request, Worker]] = {}
        self._waiting: deque[tuple[Request, FileCheck]] = deque()

    def begin(self, request: Request, check: FileCheck) -> None:
        """Starts a check. Raises UserError if another one of that command runs."""
        if request.command not in self._running:
            self._start(request, check)
        elif check.writes and len(self._waiting) < 16:
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

    def events(self) -> list[CheckEvent]:
        """Reads the children's output; returns the finished checks. A check whose client has
        disconnected is completed, because a killed one could leave files, but only writes count.
        """
        done = []
        connections = self._connections()
        for command, (request, worker) in list(self._running.items()):
            worker.read()
            if not worker.done:
                continue
            del self._running[command]
            event = _ended(request, worker)
            if command == "keep" or request.connection in connections:
                done.append(event)
            else:
                logger.info("%s cancelled: its client is gone", command)
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
