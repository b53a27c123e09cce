"""Writes single keys to a user's settings; comments and order are kept."""

from collections.abc import MutableMapping
from pathlib import Path

import tomlkit

from lfpipe.host.files import exists


def has_key(path: Path, section: str, name: str) -> bool:
    """Whether the TOML file at path sets [section] name. A file that cannot be read sets nothing."""
    try:
        return name in tomlkit.parse(path.read_text()).get(section, {})
    except (OSError, ValueError):
        return False


def write_key(path: Path, section: str, name: str, value: float | bool | str | None) -> None:
    """Sets [section] name = value in the TOML file at path, or removes it if value is None. Keeps everything else. The write is
    atomic.

    Raises OSError if it cannot be written, ValueError if it is not TOML or section is not a table.
    """
    tree = tomlkit.parse(path.read_text() if exists(path) else "")
    table = tree.setdefault(section, tomlkit.table())
    if not isinstance(table, MutableMapping):
        raise ValueError(f"{section} is not a table")
    if value is None:
        table.pop(name, None)
    else:
        table[name] = value
    path.parent.mkdir(parents=True, exist_ok=True)
    path = path.resolve()  # a link stays a link
    new = path.with_name(path.name + ".new")
    new.write_text(tomlkit.dumps(tree))
    new.replace(path)
