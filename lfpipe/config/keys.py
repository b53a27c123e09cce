"""The keys of the tree: their types, options, defaults and accepted words."""

from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import attrs

from lfpipe.config.tree import Config, Opt


def options() -> dict[str, tuple[Any, Opt, Any]]:
    """Every dotted key with (type, Opt, default), in the order of the tree."""
    found: dict[str, tuple[Any, Opt, Any]] = {}
    for section in attrs.fields(Config):
        default = getattr(Config(), section.name)
        for name, hint in get_type_hints(type(default), include_extras=True).items():
            kind, opt = get_args(hint)
            found[f"{section.name}.{name}"] = (kind, opt, getattr(default, name))
    return found


def choices(key: str) -> tuple[str, ...]:
    """The words that a key accepts, in order."""
    kind = options()[key][0]
    parts = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return tuple(word for part in parts if not isinstance(part, type) for word in get_args(part) if isinstance(word, str))
