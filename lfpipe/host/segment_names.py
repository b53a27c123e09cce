"""Names of shared memory, as entries of a folder: that of the memory itself, or a registry."""

from pathlib import Path


def names_in(folder: Path, prefix: str) -> list[str]:
    """Names that begin with prefix, of files of any kind; empty if they cannot be listed."""
    try:
        return sorted(path.name for path in folder.iterdir() if path.name.startswith(prefix))
    except OSError:
        return []
