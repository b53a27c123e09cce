"""Starts child processes.

Parent: `Child(python("MODULE"), b"...")` holds the child's standard input open. Child: reads its
first line and calls `end_with_parent`, which ends the child when that pipe ends.
`python -P -m lfpipe.host.child MODULE WORD ...` runs any module as a program in this way.
"""

import contextlib
import os
import runpy
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from typing import IO

PIPE, NULL = subprocess.PIPE, subprocess.DEVNULL
# multiple of the time limits of children: on an emulator, one face search takes seconds
PATIENCE = float(os.environ.get("LFPIPE_PATIENCE", "1"))


def python(module: str, *words: str) -> list[str]:
    """The command that runs a module with this interpreter. -P: it imports nothing from the working
    directory, which may be anybody's.
    """
    return [sys.executable, "-P", "-m", module, *words]


class Child:
    """A running child process. Raises OSError if none can be started."""

    def __init__(
        self,
        command: Sequence[str],
        line: bytes = b"",
        *,
        stdout: int | IO[bytes] | None = None,
        stderr: int | IO[bytes] | None = None,
        env: Mapping[str, str] | None = None,
        own_session: bool = False,
    ) -> None:
        """line: written to its standard input. env: None for that of this process. own_session:
        signals of the terminal do not reach it.
        """
        self.ended_fd, held = os.pipe()
        try:
            self.process = subprocess.Popen(
                command,
                bufsize=0,
                stdin=PIPE,
                stdout=stdout,
                stderr=stderr,
                env=env,
                pass_fds=(held,),
                start_new_session=own_session,
            )
        except BaseException:
            os.close(self.ended_fd)
            raise
        finally:
            os.close(held)
        self.pid = self.process.pid
        assert self.process.stdin is not None
        if line:
            with contextlib.suppress(BrokenPipeError):  # `exit_code` then reports it
                self.process.stdin.write(line + b"\n")

    def pipes(self) -> list[IO[bytes]]:
        """Its output and errors, as far as they are pipes; reading them does not block."""
        found = [pipe for pipe in (self.process.stdout, self.process.stderr) if pipe is not None]
        for pipe in found:
            os.set_blocking(pipe.fileno(), False)
        return found

    @property
    def exit_code(self) -> int | None:
        """The exit code, negative for a signal; None while it runs."""
        return self.process.poll()

    def wait(self, timeout_s: float | None = None) -> int | None:
        """Waits for its end; the exit code, or None if it still runs after timeout_s."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.process.wait(timeout_s)
        return None

    def signal(self, signum: int) -> None:
        """Sends a signal, unless it has ended."""
        self.process.send_signal(signum)

    def end(self) -> None:
        """Closes its standard input, which ends it."""
        assert self.process.stdin is not None
        self.process.stdin.close()

    def close(self) -> None:
        """Kills the child and closes the pipes. May be called again."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()
        if self.ended_fd >= 0:
            os.close(self.ended_fd)
            self.ended_fd = -1


def end_with_parent() -> None:
    """In a child: sends SIGTERM to this process when its parent ends, or closes its standard
    input, which a fork of the parent may hold open.
    """
    signs = [0]
    with contextlib.suppress(AttributeError, OSError):  # not on this system
        signs.append(os.pidfd_open(os.getppid()))
    threading.Thread(target=_wait_for_parent, args=(signs,), name="parent", daemon=True).start()


def _wait_for_parent(signs: list[int]) -> None:
    while select.select(signs, [], [])[0] == [0] and os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    end_with_parent()
    sys.argv = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name="__main__")
