"""Plug-ins: parts from other packages and of `extras`, by entry points. docs/extending.md
describes each.

lfpipe.layouts    a module or object with NAME, detect and describe (`lfpipe.scene.source.Layout`)
lfpipe.engines    a function of `config.Track` that returns a `lfpipe.track.engine.Engine`; a value
                  of track.engine
lfpipe.filters    a function of `config.Track` and device_latency_s that returns a
                  `lfpipe.track.filters.base.EyeFilter`; a value of track.filter
lfpipe.displays   a function of (argument, size_px, title, rate_hz) that returns a
                  `lfpipe.render.display.display.Display`; `--display NAME[:ARGUMENT]`
lfpipe.sources    a subclass of `lfpipe.capture.spec.SourceKind`; `--camera NAME:...`
lfpipe.commands   an `AddedCommand` or `AddedOption` of `lfpipe.cli.plugged`; its name is
                  COMMAND, GROUP.COMMAND or COMMAND.--OPTION
lfpipe.stages     a `lfpipe.transport.ring_io.Stage`: a row of the process table
lfpipe.requests   a module or object with the methods of `lfpipe.supervisor.requests.RequestPlugin`;
                  the name is that of the control command
lfpipe.painters   a function of `render.device` and a thread that returns a
                  `lfpipe.render.synthesis.painter.Painters`, or None, and what draws

Code of other packages runs only in this module: whatever it raises becomes a PluginError.
"""

import contextlib
import functools
import importlib.metadata
import logging
import numbers
import pkgutil
from collections.abc import Callable, Collection, Iterator, Mapping
from types import FunctionType, UnionType
from typing import TYPE_CHECKING, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import attrs

from lfpipe.errors import UserError

if TYPE_CHECKING:
    from numpy.typing import NDArray

LAYOUTS, ENGINES, FILTERS, DISPLAYS, SOURCES, COMMANDS, STAGES, REQUESTS, PAINTERS = GROUPS = (
    "lfpipe.layouts",
    "lfpipe.engines",
    "lfpipe.filters",
    "lfpipe.displays",
    "lfpipe.sources",
    "lfpipe.commands",
    "lfpipe.stages",
    "lfpipe.requests",
    "lfpipe.painters",
)
log = logging.getLogger(__name__)
AND = " and "  # between packages that offer a plug-in of one name
# a type, as an annotation names it, or a function that converts a result and raises TypeError
Hint = Any
Results = Mapping[str, Hint]
T = TypeVar("T")
KINDS: dict[type, tuple[type, ...]] = {  # what a program may return for another type
    int: (numbers.Integral,),  # numpy's too
    float: (numbers.Real,),
    tuple: (tuple, list),
}


def conform(value: Any, hint: Hint) -> Any:
    """value as a hint describes it: numbers, lists and tuples are converted, the fields of attrs
    classes are checked. Raises TypeError that says what is wrong.
    """
    kind, inner = _origin(hint), get_args(hint)
    if kind in (Union, UnionType):
        for one in inner:
            with contextlib.suppress(TypeError):
                return conform(value, one)
            if attrs.has(one) and isinstance(value, one):
                return conform(value, one)  # raises what is wrong with it
        raise TypeError(f"not {' or '.join(getattr(one, '__name__', str(one)) for one in inner)}")
    if isinstance(kind, FunctionType):
        return kind(value)
    if kind is Any or not isinstance(kind, type):
        return value
    allowed: Any = KINDS.get(kind, kind)
    if not isinstance(value, allowed):
        raise TypeError(f"not {kind.__name__}")
    if kind in (int, float):
        return kind(value)
    if kind is list and inner:
        return [conform(one, inner[0]) for one in value]
    if kind is tuple and inner:
        kinds = inner[:1] * len(value) if inner[-1] is ... else inner
        if len(value) != len(kinds):
            raise TypeError(f"{len(value)} values instead of {len(kinds)}")
        return tuple(map(conform, value, kinds))
    if attrs.has(kind):
        for name, part in _fields(kind).items():
            try:
                conform(getattr(value, name), part)
            except TypeError as error:
                raise TypeError(f"its {name}: {error}") from None
    return value


def _origin(hint: Hint) -> Any:
    origin: Any = get_origin(hint)
    return hint if origin is None else origin


@functools.cache
def _fields(kind: type) -> dict[str, Hint]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in attrs.fields(kind)}


def array(*shape: int, kinds: str = "f") -> "Callable[[Any], NDArray[Any]]":
    """For `conform`: an array of that shape, of a dtype whose kind is one of those."""

    import numpy as np  # which commands without arrays do not wait for

    def converted(value: Any) -> "NDArray[Any]":
        made = np.asarray(value, np.float64) if kinds == "f" else value
        if not isinstance(made, np.ndarray) or made.shape != shape or made.dtype.kind not in kinds:
            raise TypeError(f"not an array of {' x '.join(map(str, shape))}")
        return made

    return converted


@functools.cache
def entries(group: str) -> importlib.metadata.EntryPoints:
    """The entry points of a group; the search of all installed packages takes milliseconds."""
    return importlib.metadata.entry_points(group=group)


def plugins(group: str) -> dict[str, str]:
    """The package of each plugin of a group, with its version, by the plugin's name.

    Imports none of them.
    """
    offered: dict[str, str] = {}
    for entry in entries(group):
        dist = entry.dist
        package = f"{dist.name} {dist.version}" if dist and dist.name else "an unknown package"
        first = offered.get(entry.name)
        offered[entry.name] = f"{first}{AND}{package}" if first else package
    return offered


class PluginError(UserError):
    """A broken plug-in. name: of its entry point."""

    def __init__(self, name: str, message: str, remedy: str) -> None:
        super().__init__(message, remedy)
        self.name = name


# Of the process that opens scenes: layouts that are not tried, and why.
skipped: dict[str, str] = {}
# There: called with a layout's name and what it does, and ("", "") afterwards, so that the parent
# of the process knows whom to blame if it hangs or ends. Not for views, which threads read.
watchers: list[Callable[[str, str], None]] = []


@contextlib.contextmanager
def _guarded(group: str, name: str, what: str) -> Iterator[None]:
    """Turns whatever another package's code raises, also SystemExit, into PluginError."""
    watching = watchers if group == LAYOUTS and not what.endswith(" read") else ()
    for watch in watching:
        watch(name, what)
    try:
        yield
    except (UserError, KeyboardInterrupt):
        raise
    except BaseException as error:
        failure = broken(group, name, f"{what}: {type(error).__name__}: {error}")
        log.warning("%s", failure.message, exc_info=True)
        raise failure from None
    finally:
        for watch in watching:
            watch("", "")


def broken(group: str, name: str, why: str) -> PluginError:
    package = plugins(group)[name]
    remedy = f"repair or uninstall {package.partition(' ')[0]}"
    return PluginError(name, f"{name} of {package} ({group}) {why}", remedy)


class Guarded:
    """A part of a plug-in: its calls raise PluginError, also for a result that does not `conform`:
    only what is checked here reaches other code.
    """

    def __init__(self, part: Any, group: str, name: str, results: Results) -> None:
        self._part = part
        self._group = group
        self._name = name
        self._results = results

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(self._part, attribute)
        return self.bound(attribute, value) if callable(value) else self._taken(attribute, value)

    def __str__(self) -> str:
        return str(self._part)

    def guard(self, part: Any, results: Results) -> Any:
        """`guarded` for a part that this one has made."""
        return guarded(part, self._group, self._name, results)

    def bound(self, attribute: str, function: Callable[..., Any], hint: Hint = None) -> Any:
        """A function of the part, whose result is converted. hint: None for that of `results`."""

        def call(*arguments: Any, **named: Any) -> Any:
            with _guarded(self._group, self._name, f"fails in {attribute}"):
                result = function(*arguments, **named)
            return self._taken(attribute, result, hint)

        return call

    def _taken(self, attribute: str, result: Any, hint: Hint = None) -> Any:
        try:
            return conform(result, hint or self._results.get(attribute, object))
        except PluginError:
            raise
        except Exception as error:
            why = f"returns {type(result).__name__} from {attribute}: {error}"
            raise broken(self._group, self._name, why) from None


def load(group: str, name: str, built_in: Collection[str]) -> Any:
    """The object of a plug-in. built_in: names of the group that no plug-in may have.

    Raises UserError if there is none, PluginError if its package is broken.
    """
    offers = entries(group).select(name=name)
    if not offers:
        raise UserError(
            f"{group}: {name!r} is not installed",
            "install the package that offers it; `lfpipe doctor` lists them",
        )
    if name in built_in:
        raise broken(group, name, "has the name of a built-in one")
    if len(offers) > 1:
        raise broken(group, name, "is offered twice")
    with _guarded(group, name, "cannot be loaded"):
        return offers[name].load()


def load_target(group: str, name: str, target: str) -> Any:
    """The object at target, MODULE:NAME, which a plug-in names to be imported late.

    Raises PluginError.
    """
    with _guarded(group, name, "cannot be loaded"):
        return pkgutil.resolve_name(target)


def guarded(part: Any, group: str, name: str, results: Results) -> Any:
    """A part whose calls raise PluginError. results: the types that its methods return, and those
    of its other attributes; it must have each of them.
    """
    for attribute, kind in results.items():
        with _guarded(group, name, f"fails in {attribute}"):
            missing = not hasattr(part, attribute)
            value = None if missing else getattr(part, attribute)
        if missing:
            raise broken(group, name, f"has no {attribute}")
        if not callable(value):
            try:
                conform(value, kind)
            except TypeError as error:
                why = f"has {type(value).__name__} as {attribute}: {error}"
                raise broken(group, name, why) from None
    return Guarded(part, group, name, results)


def make(group: str, name: str, results: Results, *arguments: Any) -> Any:
    """Calls the function of a plug-in; returns the part that it makes, `guarded`."""
    function = load(group, name, ())
    with _guarded(group, name, "cannot be started"):
        part = function(*arguments)
    return guarded(part, group, name, results)


def declared(group: str, kind: type[T], built_in: Collection[str] = ()) -> dict[str, T]:
    """What the plug-ins of a group declare, by name: instances of kind.

    Others are logged and skipped; `lfpipe doctor` reports them.
    """
    found = {}
    for name in dict.fromkeys(entry.name for entry in entries(group)):
        try:
            part = load(group, name, built_in)
            if not isinstance(part, kind):
                raise broken(group, name, f"is {type(part).__name__}, not {kind.__name__}")
            found[name] = part
        except PluginError as error:
            log.warning("%s; it is skipped", error.message)
    return found


def loaded(group: str, built_in: Collection[str], results: Results) -> dict[str, Any]:
    """All plug-ins of a group that can be loaded, by name, each `guarded`.

    Others are logged and skipped; `lfpipe doctor` reports them.
    """
    working = {}
    for name in plugins(group):
        if group == LAYOUTS and name in skipped:
            continue
        try:
            working[name] = guarded(load(group, name, built_in), group, name, results)
        except PluginError as error:
            log.warning("%s; it is skipped", error.message)
    return working
