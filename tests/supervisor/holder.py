"""A session without stages, in a process of its own until a line comes on stdin."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]


class Holder:
    """One such process.

    Raises AssertionError with what it wrote where it does not get as far as asked.
    """

    def __init__(self, base: Path, name: str, *prefix: str) -> None:
        command = [*prefix, sys.executable, "-m", "tests.supervisor.holder", name]
        env = {**os.environ, "LFPIPE_RUN_DIR": os.fsdecode(base)}
        self.process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def ready(self) -> None:
        """Waits until the session holds its directory."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line == "ready\n", self.process.communicate(timeout=120)[1]

    def failed(self) -> str:
        """Waits for an end with exit code 2; what it said."""
        said = self.process.communicate(timeout=120)[1]
        assert self.process.returncode == 2 and "Traceback" not in said, said
        return said

    def end(self) -> str:
        """Has it end in order; what it wrote on stdout."""
        out, said = self.process.communicate("end\n", timeout=60)
        assert self.process.returncode == 0 and not said, said
        return out

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate(timeout=60)


@contextmanager
def holding(base: Path, name: str) -> Iterator[None]:
    """A session that lives as long as the block."""
    holder = Holder(base, name)
    try:
        holder.ready()
        yield
        holder.end()
    finally:
        holder.kill()


def main() -> int:
    from lfpipe import config
    from lfpipe.errors import UserError
    from lfpipe.supervisor import rundir
    from lfpipe.supervisor.session_state import SessionState, SessionStore
    from lfpipe.transport.control import Session, SessionManifest

    try:
        session = Session(sys.argv[1])
        with rundir.filled(session):
            rundir.sweep()
            lock = rundir.acquire(session)
        try:
            with rundir.filled(session):
                memory = SessionStore(
                    session, SessionState.first(config.Config(), config.SessionOptions())
                )
                SessionManifest.begin(session, {})
            print("ready", flush=True)
            sys.stdin.readline()
            memory.close()
        finally:
            rundir.remove(session.run_dir, lock)
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
