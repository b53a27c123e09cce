"""Runs `file_check` children with limits on output and time; they end with the session."""

import json
import subprocess
import sys
from typing import Any

from lfpipe.config import Config, to_dict
from lfpipe.errors import UserError
from lfpipe.host.pipes import PipeReader
from lfpipe.transport.clock import SECOND_NS, now_ns

COMMAND = (sys.executable, "-m", "lfpipe.supervisor.file_check")
MAX_ANSWER_BYTES = 64 << 10
MAX_PROGRESS_BYTES = 80
MAX_LOG_BYTES = 2000  # the end of what the child wrote to stderr
LIMITS_S = {"scene": 60.0}  # without progress: packing a large scene takes minutes
LAST_WORDS_S = 0.5  # how long what a child wrote before its end may take to arrive
LIMIT_S = 10.0  # all others check one path


class FileChecker:
    """One running child. path: what it checks. fds: for a poller; call `read` when they are readable."""

    def __init__(self, request: dict[str, Any], config: Config) -> None:
        self._limit_s = LIMITS_S.get(request["check"], LIMIT_S)
        self._delay_end()
        self.path = request["path"]
        argument = json.dumps({**request, "config": to_dict(config)})
        self._process = subprocess.Popen(
            [*COMMAND, argument],
            stdin=subprocess.PIPE,  # end of file tells the child that this process is gone
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self._out, self._log = bytearray(), bytearray()
        assert self._process.stdout is not None and self._process.stderr is not None
        self._pipes = ((PipeReader(self._process.stdout), self._out), (PipeReader(self._process.stderr), self._log))
        self._ended: list[PipeReader] = []

    def _delay_end(self) -> None:
        self._end_ns = now_ns() + int(self._limit_s * SECOND_NS)

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [fd for pipe, _ in self._pipes if pipe not in self._ended for fd in pipe.fds]

    def read(self) -> None:
        """Reads the child's output, up to the limits."""
        for pipe, kept in self._pipes:
            if pipe in self._ended:
                continue
            for _ in range(16):  # at most 1 MB per call, so that an endlessly writing child does not block the session
                data = pipe.read()
                if data is None:
                    break
                if not data:
                    self._ended.append(pipe)
                    break
                kept += data
                if kept is self._out:
                    self._delay_end()
                    del kept[: kept.rfind(b"\n", 0, -1) + 1]  # the last line is the answer
                del kept[: -MAX_ANSWER_BYTES if kept is self._out else -MAX_LOG_BYTES]

    @property
    def progress(self) -> str:
        """The child's last step, in a few words; empty before the first."""
        line = self._out.partition(b"\n")[0][:MAX_PROGRESS_BYTES].decode(errors="replace")
        return "" if line.startswith("{") else line

    @property
    def done(self) -> bool:
        """Whether the child has ended, or has exceeded its time."""
        return self._process.poll() is not None or now_ns() >= self._end_ns

    def result(self) -> dict[str, Any]:
        """The child's result, once it has ended. Raises UserError if it refused, failed or took too long."""
        ended = self._process.poll()
        self.read()
        for pipe, _ in self._pipes if ended is not None else ():
            while pipe not in self._ended and pipe.wait(LAST_WORDS_S):
                self.read()
        self.close()
        if ended is None:
            raise UserError(f"{self.path}: no progress within {self._limit_s:g} s", "check its disk or network drive")
        try:
            answer = json.loads(self._out)
            if answer["ok"]:
                return dict(answer["result"])
            refusal = UserError(str(answer["error"]), str(answer["remedy"]))
        except (ValueError, KeyError, TypeError, RecursionError):
            how = f"signal {-ended}" if ended < 0 else f"exit code {ended}"
            log = self._log.decode(errors="replace").strip()
            raise UserError(
                f"{self.path}: the process that read it ended with {how}" + (f": {log.splitlines()[-1]}" if log else ""),
                "`lfpipe scene info` on it reports more",
            ) from None
        raise refusal

    def close(self) -> None:
        """Kills the child."""
        self._process.kill()
        self._process.wait()
        assert self._process.stdin is not None
        self._process.stdin.close()
        for pipe, _ in self._pipes:
            pipe.close()
