"""The layers a configuration is made of, later ones win: the defaults, the user's file, `--config`, `--set`."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lfpipe.config.check import from_dict, merged
from lfpipe.config.tree import Config, options
from lfpipe.errors import UserError

PRESETS = Path(__file__).parent / "presets"


def parse_set(text: str) -> tuple[str, Any]:
    """`KEY=VALUE` as (dotted key, value); the value is read as TOML, a bare word as a string.

    Raises UserError where there is no `=` or no key.
    """
    key, sign, raw = text.partition("=")
    if not sign or not key.strip():
        raise UserError(f"{text!r} is not KEY=VALUE", "for example render.method=warp")
    try:
        value = tomllib.loads(f"v = {raw}")["v"]
    except tomllib.TOMLDecodeError:
        value = raw.strip()
    if isinstance(value, bool) and options().get(key.strip(), (bool,))[0] is not bool:
        value = raw.strip()  # a word, as in render.alpha_px=true
    return key.strip(), value


def user_file() -> Path:
    """Where the user's own settings are kept; need not exist."""
    import platformdirs

    return Path(platformdirs.user_config_dir("lfpipe")) / "config.toml"


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text())
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: not TOML: {error}", "`lfpipe config init` writes a complete file to start from") from None
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise UserError(f"{path}: cannot be read: {why}", "check the path and its permissions") from None


def presets() -> list[str]:
    """Names that `--config` takes besides files."""
    return sorted(path.stem for path in PRESETS.glob("*.toml"))


def load(file: str | os.PathLike[str] | None = None, sets: Iterable[str] = ()) -> Config:
    """The checked tree from the user's file, `--config` (a path or a preset's name) and `--set` texts.

    Raises UserError that names each wrong key, value and remedy.
    """
    layers: list[dict[str, Any]] = []
    if user_file().is_file():
        layers.append(_read(user_file()))
    if file is not None:
        preset = PRESETS / f"{file}.toml"
        if not Path(file).is_file() and not preset.is_file():
            raise UserError(f"--config {file}: no such file or preset", f"a TOML file, or one of: {', '.join(presets())}")
        layers.append(_read(Path(file) if Path(file).is_file() else preset))
    tree: dict[str, Any] = {}
    for layer in layers:
        flat = [(f"{s}.{k}", v) for s, t in layer.items() if isinstance(t, dict) for k, v in t.items()]
        tree = merged(tree, flat)
        tree.update({k: v for k, v in layer.items() if not isinstance(v, dict)})
    return from_dict(merged(tree, [parse_set(text) for text in sets]))
