"""What the system lets a process have, seen to before a session is built: some libraries abort where it is too little."""

from __future__ import annotations

import resource

from lfpipe.errors import UserError

OPEN_FILES = 128  # a stage has about 30 open, the supervisor as many, and one for each monitor and command


def allow_files(needed: int = OPEN_FILES) -> None:
    """Lets this process and its children have so many files open. Raises UserError where the hard limit is lower."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= hard < needed:
        raise UserError(
            f"{hard} open files are allowed here (RLIMIT_NOFILE), a session needs {needed}",
            f"`ulimit -n {max(1024, needed)}` in the shell that starts it, or LimitNOFILE= where systemd does",
        )
    if 0 <= soft < needed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
