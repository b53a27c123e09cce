"""`lightfield.toml`: the user's statements about the views in a folder. They override detection,
and settings of the session override them.

    # lightfield.toml
    written_by = "lfpipe scene describe"
    [scene]
    layout = "numbered"
    grid = "9x9"

The keys are those of [scene], without `cache_dir`.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs

from lfpipe import config
from lfpipe.config.check import updated
from lfpipe.config.tree import options
from lfpipe.errors import UserError
from lfpipe.files.safe_files import read_text, write_file
from lfpipe.files.untrusted import toml_table
from lfpipe.host.files import is_file

FILE = "lightfield.toml"
WRITTEN_BY = "lfpipe scene describe"
KEYS = tuple(field.name for field in attrs.fields(config.Scene) if field.name != "cache_dir")
REMEDY = f"correct the file, or write it again: `{WRITTEN_BY} FOLDER --grid ROWSxCOLS`"


def stated(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The keys of [scene] that `lightfield.toml` in the folder at path states; empty if absent.

    Raises UserError if the file is not as described above.
    """
    file = Path(path) / FILE
    if not is_file(file):
        return {}
    table = toml_table(_text(file), str(file), REMEDY)
    values = table.pop("scene", {})
    written_by = table.pop("written_by", "")
    if table or not isinstance(values, dict) or not isinstance(written_by, str):
        odd = ", ".join(map(repr, table)) or "written_by, scene"
        raise UserError(f"{file}: expected written_by (text) and [scene], found {odd}", REMEDY)
    if unknown := [name for name in values if name not in KEYS]:
        raise UserError(f"{file}: scene.{unknown[0]} cannot be stated there", REMEDY)
    try:
        updated(config.Config(), _dotted(values))
    except UserError as error:
        raise UserError(f"{file}: {error.message}", REMEDY) from None
    return values


def with_stated(settings: config.Scene, values: Mapping[str, Any]) -> config.Scene:
    """settings with the stated values where it has defaults, except the depth order, which is
    session state.
    """
    used = {
        name: value
        for name, value in values.items()
        if name != "invert_depth" and getattr(settings, name) == options()[f"scene.{name}"].default
    }
    return updated(attrs.evolve(config.Config(), scene=settings), _dotted(used)).scene


def describe_folder(folder: Path, settings: config.Scene) -> Path:
    """Writes the file that states every key of settings that is not its default; returns its path.

    Raises UserError if there is nothing to state, or if another program wrote the file.
    """
    import tomlkit

    values = {
        name: getattr(settings, name)
        for name in KEYS
        if getattr(settings, name) != options()[f"scene.{name}"].default
    }
    file = folder / FILE
    if not values:
        raise UserError(f"{folder}: nothing to state", "name a key, for example --grid 9x9")
    if is_file(file) and f'written_by = "{WRITTEN_BY}"' not in _text(file):
        raise UserError(
            f"{file}: exists, and `{WRITTEN_BY}` did not write it", "edit it, or move it away"
        )
    document = tomlkit.document()
    document["written_by"] = WRITTEN_BY
    document["scene"] = values
    write_file(file, tomlkit.dumps(document).encode(), 0o644)
    return file


def _text(file: Path) -> str:
    return read_text(file, str(file), REMEDY)


def _dotted(values: Mapping[str, Any]) -> dict[str, Any]:
    return {f"scene.{name}": value for name, value in values.items()}
