"""What comes from outside, checked against the tree: all that is wrong is told at once, each with its key, value and remedy."""

from __future__ import annotations

import difflib
import functools
from collections.abc import Iterable, Mapping
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin

import attrs

from lfpipe.config.tree import Config, Opt, options, to_dict
from lfpipe.errors import UserError

if TYPE_CHECKING:  # at run time only where something is checked: a stage takes a tree that was, and starts sooner for it
    import cattrs


def _wrong(value: object, kind: Any, opt: Opt) -> str | None:
    """Why value is not of kind and within opt, or None."""
    shape: Any = get_origin(kind)
    parts: tuple[Any, ...] = get_args(kind) if shape in (Union, UnionType) else (kind,)
    words = [word for part in parts if not isinstance(part, type) for word in get_args(part)]  # of its Literal
    if value in words and isinstance(value, str):
        return None
    number = float in parts or int in parts
    if number and isinstance(value, int | float) and not isinstance(value, bool):
        if int in parts and not isinstance(value, int):
            return f"{value!r} is not a whole number"
        low, high = opt.low, opt.high
        if value != value or (low is not None and value < low) or (high is not None and value > high):
            return f"{value!r} is out of range: {low:g} to {high:g} {opt.unit}".rstrip()
        return None
    if (bool in parts and isinstance(value, bool)) or (str in parts and isinstance(value, str)):
        return None
    if words and not number:
        close = difflib.get_close_matches(str(value), words, 1, 0.5)
        return f"{value!r} is not one of {', '.join(words)}" + (f" (did you mean {close[0]!r}?)" if close else "")
    wanted = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}
    names = [wanted[part] for part in parts if part in wanted] + [repr(word) for word in words]
    return f"{value!r} is not {' or '.join(names)}"


@functools.cache
def _converter() -> cattrs.Converter:
    import cattrs

    converter = cattrs.Converter(forbid_extra_keys=True)

    def is_annotated(hint: Any) -> bool:
        shape: Any = get_origin(hint)
        return shape is Annotated

    def annotated(hint: Any) -> Any:
        kind, opt = get_args(hint)

        def structure(value: object, _: Any) -> Any:
            if problem := _wrong(value, kind, opt):
                raise ValueError(problem)
            whole = float in (kind, *get_args(kind)) and isinstance(value, int) and not isinstance(value, bool)
            return float(value) if whole and isinstance(value, int) else value

        return structure

    converter.register_structure_hook_factory(is_annotated, annotated)
    return converter


def _problems(error: BaseException, path: str) -> Iterable[str]:
    """The leaves of a cattrs error as `key: what is wrong` lines."""
    from cattrs.errors import ClassValidationError, ForbiddenExtraKeysError

    if isinstance(error, ClassValidationError):
        named, rest = error.group_exceptions()
        for inner, note in named:
            yield from _problems(inner, f"{path}.{note.name}" if path else note.name)
        for inner in rest:
            yield from _problems(inner, path)
    elif isinstance(error, ForbiddenExtraKeysError):
        for name in sorted(error.extra_fields):
            key = f"{path}.{name}" if path else name
            known = list(options()) if path else [*options(), *(section.name for section in attrs.fields(Config))]
            close = difflib.get_close_matches(key, known, 1, 0.6)
            yield f"{key}: unknown key" + (f", did you mean {close[0]!r}?" if close else "")
    else:
        yield f"{path}: {error}" if isinstance(error, ValueError) else f"{path}: a table is needed here ([{path}])"


def from_dict(tree: Mapping[str, Any]) -> Config:
    """A checked Config from nested dicts; missing keys take their defaults.

    Raises UserError that lists every wrong key at once.
    """
    from cattrs.errors import ClassValidationError, ForbiddenExtraKeysError

    try:
        return _converter().structure(tree, Config)
    except (ClassValidationError, ForbiddenExtraKeysError) as error:
        raise UserError(
            "configuration: " + "\n  ".join(_problems(error, "")),
            "`lfpipe config show` lists every key with its unit and range",
        ) from None


def merged(tree: Mapping[str, Any], sets: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """tree with dotted keys put in; the result is unchecked (`from_dict` checks it)."""
    out: dict[str, Any] = {k: dict(v) if isinstance(v, Mapping) else v for k, v in tree.items()}
    for key, value in sets:
        section, _, name = key.partition(".")
        table = out.setdefault(section, {})
        if name and isinstance(table, dict):
            table[name] = value
        else:
            out[section] = value
    return out


def updated(config: Config, sets: Mapping[str, Any], live_only: bool = False) -> Config:
    """config with dotted keys changed, checked whole.

    live_only: refuse keys that a running session cannot take. Raises UserError; config itself never changes.
    """
    new = from_dict(merged(to_dict(config), sets.items()))
    if live_only:
        known = options()
        fixed = [key for key in sets if not known[key][1].live]
        if fixed:
            raise UserError(f"{', '.join(fixed)}: fixed while a session runs", "stop it and give the key to `lfpipe up --set`")
    return new
