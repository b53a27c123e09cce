"""The layers of a configuration: defaults, the user's file, `--config`, `--set`. Later layers win."""

import math
import os
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lfpipe.config.check import changed, flat, problems, refusal, wrong_text
from lfpipe.config.tree import Config, options
from lfpipe.config.user_files import FILE_BYTES, user_file
from lfpipe.errors import UserError, shown
from lfpipe.files.safe_files import read_text
from lfpipe.files.untrusted import toml_table
from lfpipe.host.files import is_missing

PRESETS = Path(__file__).parent / "presets"


def parse_set(text: str) -> tuple[str, bool | int | float | str]:
    """Parses `KEY=VALUE` to (dotted key, value). The value is a number, boolean or string in TOML syntax; anything else is
    plain text. `updated` checks the key and its value.

    Raises UserError if `=` or the key is missing, or if a character is not allowed.
    """
    key, sign, raw = text.partition("=")
    key, raw = key.strip(), raw.strip()
    if not sign or not key:
        raise UserError(f"{shown(text)} is not KEY=VALUE", "for example render.method=warp")
    value: object = raw
    try:
        table = tomllib.loads(f"v = {raw}")
        value = table["v"] if len(table) == 1 else raw
    except (ValueError, RecursionError):  # a bare word, or endless digits or brackets
        pass
    if isinstance(value, int) and value.bit_length() > 63:
        value = math.inf if value > 0 else -math.inf  # out of every range, and too large for a message
    word = isinstance(value, bool) and key in options() and bool not in options()[key].types  # as in screen.monitor=true
    if word or not isinstance(value, bool | int | float | str):
        value = raw
    for part in (key, value):
        if isinstance(part, str) and (why := wrong_text(part)):
            raise refusal([f"{shown(key)}: {why}"])
    return key, value


def presets() -> list[str]:
    """Names of presets that `--config` accepts."""
    return sorted(path.stem for path in PRESETS.glob("*.toml"))


def _files(file: str | os.PathLike[str] | None) -> list[tuple[str, Path]]:
    """(name in messages, path) of the files to read; later ones win."""
    own = user_file()
    files = [(str(own), own)] if not is_missing(own) else []
    if file is None:
        return files
    name = os.fspath(file)
    preset = name in presets() and is_missing(name)
    return [*files, (f"--config {name}", PRESETS / f"{name}.toml" if preset else Path(name))]


def load(file: str | os.PathLike[str] | None = None, sets: Iterable[str] = ()) -> Config:
    """The checked tree from the user's file, `--config` (a path or a preset's name) and `--set` texts.

    Raises UserError with each wrong file, key, value and remedy.
    """
    values: dict[str, Any] = {}
    wrong: list[str] = []
    form = f"name a TOML file (`lfpipe config init` writes a complete one), or a preset: {', '.join(presets())}"
    remedy: list[str] = []
    for name, path in _files(file):
        try:
            pairs = flat(toml_table(read_text(path, FILE_BYTES, name, form), name, form))
        except UserError as error:
            wrong.append(error.message)
            remedy = [form]
            continue
        wrong += [f"{name}: {problem}" for problem in problems(pairs)]
        values |= {str(key): value for key, value in pairs}
    for text in sets:
        try:
            key, value = parse_set(text)
        except UserError as error:
            wrong.append(error.message.removeprefix("configuration: "))
            continue
        wrong += problems([(key, value)])
        values[key] = value
    if wrong:
        raise refusal(wrong, *remedy)
    return changed(Config(), values)
