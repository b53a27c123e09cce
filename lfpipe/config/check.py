"""Checks values from outside against the tree. Reports all problems at once, each with its key, value and remedy.

Values may have any type and depth that TOML, msgpack or a caller can carry. The only exception raised is UserError.
"""

import difflib
import functools
import json
import unicodedata
from collections.abc import Iterable, Mapping
from types import UnionType
from typing import Any, Union, get_args, get_origin

from lfpipe.config.keys import choices, options
from lfpipe.config.tree import Config, Opt, to_dict, trusted
from lfpipe.errors import UserError, shown
from lfpipe.plugins import ENGINES, FILTERS, plugins

TEXT_CHARS = 4096  # of any text; the longest path
WRONG_SHOWN = 10
UNKNOWN_SHOWN = 5
PLUGGABLE = {"track.engine": ENGINES, "track.filter": FILTERS}  # keys whose words other packages may add
REPLACED = {"render.display_ms": "render.loop_ms"}  # former keys


def _wrong(value: object, kind: Any, opt: Opt) -> str | None:
    """Why value is not of kind and within opt, or None."""
    shape: Any = get_origin(kind)
    parts: tuple[Any, ...] = get_args(kind) if shape in (Union, UnionType) else (kind,)
    words = [word for part in parts if not isinstance(part, type) for word in get_args(part)]  # of its Literal
    if any(type(value) is type(word) and value == word for word in words):
        return None
    if isinstance(value, int | float) and not isinstance(value, bool) and (float in parts or int in parts):
        if int in parts and not isinstance(value, int):
            return f"{shown(value)} is not a whole number"
        if value != value or not opt.low <= value <= opt.high:
            return f"{shown(value)} is out of range: {opt.low:g} to {opt.high:g} {opt.unit}".rstrip()
        return None
    if isinstance(value, str) and str in parts:
        return wrong_text(value)
    if isinstance(value, bool) and bool in parts:
        return None
    wanted = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}
    names = [wanted[part] for part in parts if part in wanted]
    if words and not names:
        texts = [str(word) for word in words]
        close = _close(value, texts, 0.5)
        return f"{shown(value)} is not one of {', '.join(texts)}" + (f" (did you mean {close!r}?)" if close else "")
    return f"{shown(value)} is not {' or '.join([*names, *map(repr, words)])}"


def wrong_text(value: str) -> str | None:
    """Texts are paths and names: they must survive a message, a file and a system call."""
    if len(value) > TEXT_CHARS:
        return f"{shown(value)} has {len(value)} characters; at most {TEXT_CHARS} are allowed"
    odd = next((c for c in value if unicodedata.category(c) in ("Cc", "Cs")), "")
    return f"{shown(value)} contains {odd!a}, which is not allowed in text" if odd else None


@functools.cache
def sections() -> tuple[str, ...]:
    """Names of the tables, in their order."""
    return tuple(to_dict(Config()))


def _unknown(key: object) -> str:
    """The message for an unknown key."""
    if not isinstance(key, str):
        return f"{shown(key)}: unknown key"
    if key in REPLACED:
        return f"{key}: write {REPLACED[key]} instead: {options()[REPLACED[key]][1].doc}"
    section = key.partition(".")[0]
    if section not in sections():
        key = section
    close = _close(key, [*options(), *sections()], 0.6)
    return f"{key if len(key) < 40 else shown(key)}: unknown key" + (f", did you mean {close!r}?" if close else "")


def _close(value: object, texts: Iterable[str], cutoff: float) -> str:
    """The closest of texts to value, a likely typing error; "" without one."""
    close = difflib.get_close_matches(value, list(texts), 1, cutoff) if isinstance(value, str) and len(value) < 40 else []
    return close[0] if close else ""


def corrected(key: str, value: object) -> str:
    """KEY=VALUE with the likely typing error corrected, for `--set`; "" without one."""
    meant = key if key in options() else REPLACED.get(key) or _close(key, options(), 0.6)
    if not meant:
        return ""
    kind, opt, _ = options()[meant]
    if _wrong(value, kind, opt):
        value = _close(value, choices(meant), 0.5)
    return f"{meant}={json.dumps(value) if isinstance(value, bool) else value}" if value != "" else ""


def problems(values: Iterable[tuple[object, object]]) -> list[str]:
    """All problems of (dotted key, value) pairs, as `key: problem`. A long list is cut, with the number of further problems."""
    wrong, unknown = [], []
    known = options()
    for key, value in values:
        if isinstance(key, str) and key in known:
            kind, opt, _ = known[key]
            why = _wrong(value, kind, opt)
            if why and not (key in PLUGGABLE and isinstance(value, str) and value in plugins(PLUGGABLE[key])):
                wrong.append(f"{key}: {why}")
        elif isinstance(key, str) and key in sections():
            wrong.append(f"{key}: a section, which cannot have the value {shown(value)}; its keys are {key}.{_first(key)}, ...")
        else:
            unknown.append(key)
    said = wrong[:WRONG_SHOWN] + ([f"and {len(wrong) - WRONG_SHOWN} more values"] if len(wrong) > WRONG_SHOWN else [])
    said += [_unknown(key) for key in unknown[:UNKNOWN_SHOWN]]
    return said + ([f"and {len(unknown) - UNKNOWN_SHOWN} more unknown keys"] if len(unknown) > UNKNOWN_SHOWN else [])


def _first(section: str) -> str:
    return str(next(iter(to_dict(Config())[section])))


def refusal(wrong: list[str], *remedies: str) -> UserError:
    """All problems as one UserError."""
    listed = "`lfpipe config show` lists every key with its unit and range"
    return UserError("configuration: " + "\n  ".join(wrong), "; ".join(remedies or (listed,)))


def flat(tree: Mapping[Any, Any]) -> list[tuple[object, object]]:
    """(dotted key, value) pairs of nested tables. A value that is not a table keeps its own name."""
    found: list[tuple[object, object]] = []
    for section, table in tree.items():
        if isinstance(section, str) and section in sections() and isinstance(table, Mapping):
            found += [(f"{section}.{key}" if isinstance(key, str) else key, value) for key, value in table.items()]
        else:
            found.append((section, table))
    return found


def changed(config: Config, values: Mapping[str, Any]) -> Config:
    """Returns config with dotted keys changed; `problems` must have accepted them."""
    tree, known = to_dict(config), options()
    for key, value in values.items():
        section, _, name = key.partition(".")
        kind = known[key][0]
        number = isinstance(value, int) and not isinstance(value, bool) and float in (kind, *get_args(kind))
        tree[section][name] = float(value) if number else value
    return trusted(tree)


def updated(config: Config, sets: Mapping[str, Any], live_only: bool = False) -> Config:
    """Returns config with dotted keys changed: all of them, or none if one is refused.

    live_only: refuse keys that cannot change while a session runs. Raises UserError; config itself never changes.
    """
    if wrong := problems(sets.items()):
        raise refusal(wrong)
    known = options()
    fixed = [key for key in sets if live_only and not known[key][1].live]
    if fixed:
        raise UserError(f"{', '.join(fixed)}: fixed while a session runs", "stop it and give the key to `lfpipe up --set`")
    return changed(config, sets)


def from_dict(tree: Mapping[str, Any]) -> Config:
    """Returns a checked Config from nested dicts; missing keys have their defaults. Raises UserError with all problems."""
    if not isinstance(tree, Mapping):
        raise refusal([f"{shown(tree)} is not a table of sections"])
    values = flat(tree)
    if wrong := problems(values):
        raise refusal(wrong)
    return changed(Config(), {str(key): value for key, value in values})
