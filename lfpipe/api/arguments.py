"""Types of arguments: a program's mistake raises TypeError that names the parameter."""

import functools
import inspect
import types
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.lightfield import LightField

P = ParamSpec("P")
T = TypeVar("T")
UNCHECKED = (LightField, tuple)
NUMBERS = {float: (int, float, np.integer, np.floating), int: (int, np.integer)}


def typed(function: Callable[P, T]) -> Callable[P, T]:
    """The function, which raises TypeError for arguments that its annotations exclude. It does not
    check light fields and places, whose functions have messages of their own, and arrays: see
    `numbers`.
    """
    signature = inspect.signature(function)
    kinds: dict[str, tuple[type, ...]] = {}

    @functools.wraps(function)
    def checked(*arguments: P.args, **named: P.kwargs) -> T:
        if not kinds:
            hints = get_type_hints(function)
            kinds.update({name: _classes(hints.get(name, object)) for name in signature.parameters})
        for name, value in signature.bind(*arguments, **named).arguments.items():
            if not _fits(value, kinds[name]):
                words = " or ".join(dict.fromkeys(kind.__name__ for kind in kinds[name]))
                raise TypeError(f"{name} must be {words}, not {type(value).__name__}")
            if Mapping in kinds[name] and value and not all(isinstance(key, str) for key in value):
                raise TypeError(f"{name} must have keys that are text")
        return function(*arguments, **named)

    return checked


def numbers(name: str, value: Any) -> NDArray[Any]:
    """value as an array. Raises TypeError that names the parameter if it has no numbers."""
    try:
        array = np.asarray(value)
    except ValueError as error:  # rows of several lengths
        raise TypeError(f"{name} must be an array: {error}") from None
    if array.dtype.kind not in "buif":
        what = f"an array of {array.dtype}" if array.ndim else type(value).__name__
        raise TypeError(f"{name} must be an array of numbers, not {what}")
    return array


def _classes(hint: Any) -> tuple[type, ...]:
    """The classes of an annotation; object for one that is more than classes."""
    if get_origin(hint) in (Union, types.UnionType):
        return tuple(kind for part in get_args(hint) for kind in _classes(part))
    kind = get_origin(hint) or hint
    if not isinstance(kind, type) or kind in UNCHECKED or getattr(kind, "_is_protocol", False):
        return (object,)
    return NUMBERS.get(kind, (kind,))


def _fits(value: object, kinds: tuple[type, ...]) -> bool:
    if isinstance(value, bool) and not {bool, object} & {*kinds}:
        return False
    return isinstance(value, kinds)
