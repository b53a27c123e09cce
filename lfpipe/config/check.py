"""Checks values from outside against the tree. Reports all problems at once, each with its key, value and remedy.

Values may have any type and depth that TOML, msgpack or a caller can carry. The only exception raised is UserError.
"""

import difflib
import json
import unicodedata
from collections.abc import Iterable, Mapping
from typing import Any

from lfpipe.config.tree import SECTIONS, Config, Key, choices, options, to_dict, trusted
from lfpipe.errors import UserError, shown
from lfpipe.plugins import ENGINES, FILTERS, plugins

TEXT_CHARS = 4096  # of any text; the longest path
WRONG_SHOWN, UNKNOWN_SHOWN = 10, 5  # problems that one message names
NAMES = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}
PLUGGABLE = {"track.engine": ENGINES, "track.filter": FILTERS}  # keys whose words other packages may add
REPLACED = {"render.display_ms": "render.loop_ms"}  # former keys


def _wrong(value: object, key: Key) -> str:
    """Why a key cannot have this value, or ""."""
    if any(type(value) is type(word) and value == word for word in key.words):
        return ""
    if isinstance(value, bool) and bool in key.types:
        return ""
    if isinstance(value, int | float) and not isinstance(value, bool) and (float in key.types or int in key.types):
        if int in key.types and not isinstance(value, int):
            return f"{shown(value)} is not a whole number"
        if not key.low <= value <= key.high:  # also nan
            return f"{shown(value)} is out of range: {key.low:g} to {key.high:g} {key.unit}".rstrip()
        return ""
    if isinstance(value, str) and str in key.types:
        return wrong_text(value)
    if key.types:
        return f"{shown(value)} is not {' or '.join([*(NAMES[kind] for kind in key.types), *map(repr, key.words)])}"
    texts = [str(word) for word in key.words]
    close = closest(value, texts, 0.5)
    return f"{shown(value)} is not one of {', '.join(texts)}" + (f" (did you mean {close!r}?)" if close else "")


def wrong_text(value: str) -> str:
    """Why a text is refused, or "". Texts are paths and names: they must survive a message, a file and a system call."""
    if len(value) > TEXT_CHARS:
        return f"{shown(value)} has {len(value)} characters; at most {TEXT_CHARS} are allowed"
    odd = next((c for c in value if unicodedata.category(c) in ("Cc", "Cs")), "")
    return f"{shown(value)} contains {odd!a}, which is not allowed in text" if odd else ""


def _unknown(key: object) -> str:
    """The message for an unknown key."""
    if not isinstance(key, str):
        return f"{shown(key)}: unknown key"
    if key in REPLACED:
        return f"{key}: write {REPLACED[key]} instead: {options()[REPLACED[key]].doc}"
    section = key.partition(".")[0]
    if section not in SECTIONS:
        key = section
    close = closest(key, [*options(), *SECTIONS])
    return f"{key if len(key) < 40 else shown(key)}: unknown key" + (f", did you mean {close!r}?" if close else "")


def closest(value: object, texts: Iterable[str], cutoff: float = 0.6) -> str:
    """The closest of texts to value, a likely typing error; "" without one."""
    close = difflib.get_close_matches(value, list(texts), 1, cutoff) if isinstance(value, str) and len(value) < 40 else []
    return close[0] if close else ""


def corrected(key: str, value: object) -> str:
    """KEY=VALUE with the likely typing error corrected, for `--set`; "" without one."""
    meant = key if key in options() else REPLACED.get(key) or closest(key, options())
    if meant and _wrong(value, options()[meant]):
        value = closest(value, choices(meant), 0.5)
    return f"{meant}={json.dumps(value) if isinstance(value, bool) else value}" if meant and value != "" else ""


def problems(values: Iterable[tuple[object, object]]) -> list[str]:
    """All problems of (dotted key, value) pairs, as `key: problem`. A long list is cut, with the number of further problems."""
    wrong, unknown = [], []
    for key, value in values:
        if isinstance(key, str) and key in options():
            why = _wrong(value, options()[key])
            if why and not (key in PLUGGABLE and isinstance(value, str) and value in plugins(PLUGGABLE[key])):
                wrong.append(f"{key}: {why}")
        elif isinstance(key, str) and key in SECTIONS:
            first = next(name for name in options() if name.startswith(f"{key}."))
            wrong.append(f"{key}: a section, which cannot have the value {shown(value)}; its keys are {first}, ...")
        else:
            unknown.append(key)
    listed = wrong[:WRONG_SHOWN] + ([f"and {len(wrong) - WRONG_SHOWN} more values"] if len(wrong) > WRONG_SHOWN else [])
    listed += [_unknown(key) for key in unknown[:UNKNOWN_SHOWN]]
    return listed + ([f"and {len(unknown) - UNKNOWN_SHOWN} more unknown keys"] if len(unknown) > UNKNOWN_SHOWN else [])


def refusal(wrong: list[str], *remedies: str) -> UserError:
    """All problems as one UserError."""
    listed = "`lfpipe config show` lists every key with its unit and range"
    return UserError("configuration: " + "\n  ".join(wrong), "; ".join(remedies or (listed,)))


def flat(tree: Mapping[Any, Any]) -> list[tuple[object, object]]:
    """(dotted key, value) pairs of nested tables. A value that is not a table keeps its own name."""
    pairs: list[tuple[object, object]] = []
    for section, table in tree.items():
        if isinstance(section, str) and section in SECTIONS and isinstance(table, Mapping):
            pairs += [(f"{section}.{key}" if isinstance(key, str) else key, value) for key, value in table.items()]
        else:
            pairs.append((section, table))
    return pairs


def changed(config: Config, values: Mapping[str, Any]) -> Config:
    """Returns config with dotted keys changed; `problems` must have accepted them."""
    tree = to_dict(config)
    for key, value in values.items():
        section, _, name = key.partition(".")
        number = isinstance(value, int) and not isinstance(value, bool) and float in options()[key].types
        tree[section][name] = float(value) if number else value
    return trusted(tree)


def updated(config: Config, sets: Mapping[str, Any], live_only: bool = False) -> Config:
    """Returns config with dotted keys changed: all of them, or none if one is refused.

    live_only: refuse keys that cannot change while a session runs. Raises UserError; config itself never changes.
    """
    if wrong := problems(sets.items()):
        raise refusal(wrong)
    if fixed := [key for key in sets if live_only and not options()[key].live]:
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
