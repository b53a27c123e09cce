"""Runs `file_check` children: their output is drained and bounded, their time is limited, and they end with the session."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from typing import IO, Any

from lfpipe.config import Config, to_dict
from lfpipe.errors import UserError
from lfpipe.transport.clock import SECOND_NS, now_ns

COMMAND = (sys.executable, "-m", "lfpipe.supervisor.file_check")
MAX_ANSWER_BYTES = 64 << 10
MAX_LOG_BYTES = 2000  # the end of what the child wrote to stderr
LIMITS_S = {"scene": 60.0}  # without progress: packing a large scene takes minutes
LIMIT_S = 10.0  # everything else looks at one path


class FileChecker:
    """One child at work. fds: for a poller; call `read` when they are readable."""

    def __init__(self, request: dict[str, Any], config: Config) -> None:
        self._limit_s = LIMITS_S.get(request["check"], LIMIT_S)
        self._progress()
        self._path = request["path"]
        argument = json.dumps({**request, "config": to_dict(config)})
        self._process = subprocess.Popen(
            [*COMMAND, argument],
            stdin=subprocess.PIPE,  # its end tells the child that this process is gone
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self._out, self._log = bytearray(), bytearray()
        for stream in self._streams:
            os.set_blocking(stream.fileno(), False)

    def _progress(self) -> None:
        self._end_ns = now_ns() + int(self._limit_s * SECOND_NS)

    @property
    def _streams(self) -> list[IO[bytes]]:
        return [stream for stream in (self._process.stdout, self._process.stderr) if stream is not None and not stream.closed]

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [stream.fileno() for stream in self._streams]

    def read(self) -> None:
        """Takes what the child has written, as far as it is of use."""
        for stream, kept in ((self._process.stdout, self._out), (self._process.stderr, self._log)):
            if stream is None or stream.closed:
                continue
            with contextlib.suppress(BlockingIOError):
                for _ in range(16):  # 1 MB at a time: a child that never stops writing does not hold up the session
                    data = os.read(stream.fileno(), 1 << 16)
                    if not data:
                        stream.close()
                        break
                    kept += data
                    if kept is self._out:
                        self._progress()
                        del kept[: kept.rfind(b"\n", 0, -1) + 1]  # the last line is the answer
                    del kept[: -MAX_ANSWER_BYTES if kept is self._out else -MAX_LOG_BYTES]

    @property
    def done(self) -> bool:
        """Whether the child has ended, or its time has."""
        return self._process.poll() is not None or now_ns() >= self._end_ns

    def result(self) -> dict[str, Any]:
        """The child's result, once it has ended. Raises UserError where it refuses, failed or took too long."""
        ended = self._process.poll()
        self.read()
        self.close()
        if ended is None:
            raise UserError(f"{self._path}: no progress within {self._limit_s:g} s", "is its disk or network drive there?")
        try:
            answer = json.loads(self._out)
            if answer["ok"]:
                return dict(answer["result"])
            refusal = UserError(str(answer["error"]), str(answer["remedy"]))
        except (ValueError, KeyError, TypeError, RecursionError):
            how = f"signal {-ended}" if ended < 0 else f"exit code {ended}"
            log = self._log.decode(errors="replace").strip()
            raise UserError(
                f"{self._path}: the process that read it ended with {how}" + (f": {log.splitlines()[-1]}" if log else ""),
                "`lfpipe scene info` on it says more",
            ) from None
        raise refusal

    def close(self) -> None:
        """Ends the child, whatever it does."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()
