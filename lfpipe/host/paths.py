"""What a path is, as far as this process may know: False where that cannot be examined.

`Path.exists`, `is_file` and `is_dir` raise OSError up to Python 3.13 for a folder that may not be searched, a name that is too
long, a network drive that has gone. Who needs the reason opens the path.
"""

import os
from os.path import exists, isdir, isfile

__all__ = ["exists", "is_dir", "is_file", "is_missing"]

is_file, is_dir = isfile, isdir


def is_missing(path: str | os.PathLike[str]) -> bool:
    """Whether there is certainly nothing at path, not even a broken link."""
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        return False
    return False
