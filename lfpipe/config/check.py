"""Checks values from outside against the tree. Reports all problems at once, each with its key, value and remedy.

Values may have any type and depth that TOML, msgpack or a caller can carry. The only exception raised is UserError.
"""

import difflib
import itertools
import unicodedata
from collections.abc import Iterable, Mapping
from typing import Any

from lfpipe.config.tree import SECTIONS, Config, Key, options, to_dict, trusted
from lfpipe.errors import UserError, shown
from lfpipe.plugins import ENGINES, FILTERS, plugins

TEXT_CHARS = 4096  # of any text; the longest path
MOST_LISTED = 10  # problems that one message names
NAMES = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}
PLUGGABLE = {"track.engine": ENGINES, "track.filter": FILTERS}  # keys whose words other packages may add


def _problem(name: object, value: object) -> str:
    """`key: problem`; "" if the key takes this value."""
    if not isinstance(name, str):
        return f"{shown(name)}: unknown key"
    if name in options():
        plugged = name in PLUGGABLE and isinstance(value, str) and value in plugins(PLUGGABLE[name])
        why = "" if plugged else _wrong(value, options()[name])
        return why and f"{name}: {why}"
    if name in SECTIONS:
        first = next(key for key in options() if key.startswith(f"{name}."))
        return f"{name}: a section, which cannot have the value {shown(value)}; its keys are {first}, ..."
    section = name.partition(".")[0]
    name = name if section in SECTIONS else section
    close = closest(name, [*options(), *SECTIONS])
    return f"{name if len(name) < 40 else shown(name)}: unknown key" + (f", did you mean {close!r}?" if close else "")


def _wrong(value: object, key: Key) -> str:
    """Why a key cannot have this value, or ""."""
    if any(type(value) is type(word) and value == word for word in key.words) or (isinstance(value, bool) and bool in key.types):
        return ""
    if isinstance(value, int | float) and not isinstance(value, bool) and (float in key.types or int in key.types):
        if int in key.types and not isinstance(value, int):
            return f"{shown(value)} is not a whole number"
        inside = key.low <= value <= key.high  # false for nan
        return "" if inside else f"{shown(value)} is out of range: {key.low:g} to {key.high:g} {key.unit}".rstrip()
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


def closest(value: object, texts: Iterable[str], cutoff: float = 0.6) -> str:
    """The closest of texts to value, a likely typing error; "" without one."""
    close = difflib.get_close_matches(value, list(texts), 1, cutoff) if isinstance(value, str) and len(value) < 40 else []
    return close[0] if close else ""


def problems(values: Iterable[tuple[object, object]]) -> list[str]:
    """The problems of (dotted key, value) pairs: the first MOST_LISTED, and whether there are more."""
    wrong = list(itertools.islice(filter(None, itertools.starmap(_problem, values)), MOST_LISTED + 1))
    return [*wrong[:MOST_LISTED], "and more"] if len(wrong) > MOST_LISTED else wrong


def refusal(wrong: list[str], remedy: str = "`lfpipe config show` lists every key with its unit and range") -> UserError:
    """All problems as one UserError."""
    return UserError("configuration: " + "\n  ".join(wrong), remedy)


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
