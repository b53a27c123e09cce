"""The home directory, which a container may lack."""

import os
import pwd
import tempfile
from pathlib import Path


def provide_home() -> None:
    """Sets HOME where there is neither the variable nor an entry of the user: to a folder of the
    user's own among the temporary ones.
    """
    if os.environ.get("HOME"):
        return
    try:
        home = Path(pwd.getpwuid(os.getuid()).pw_dir)
    except KeyError:
        home = Path(tempfile.gettempdir()) / f"lfpipe-home-{os.getuid()}"
        home.mkdir(0o700, exist_ok=True)
        if home.lstat().st_uid != os.getuid():  # another user was here first
            home = Path(tempfile.mkdtemp(prefix="lfpipe-home-"))
    os.environ["HOME"] = str(home)
