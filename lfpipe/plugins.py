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
lfpipe.stages     a `lfpipe.supervisor.stage_row.Stage`: a row of the process table
lfpipe.requests   a module or object with the methods of `lfpipe.supervisor.requests.RequestPlugin`;
                  the name is that of the control command

Code of other packages runs only in this module: whatever it raises becomes a PluginError.
"""

import contextlib
import functools
import importlib.metadata
import logging
import pkgutil
from collections.abc import Callable, Collection, Iterator, Mapping
from types import UnionType
from typing import Any, TypeVar

from lfpipe.errors import UserError

LAYOUTS, ENGINES, FILTERS, DISPLAYS, SOURCES, COMMANDS, STAGES, REQUESTS = GROUPS = (
    "lfpipe.layouts",
    "lfpipe.engines",
    "lfpipe.filters",
    "lfpipe.displays",
    "lfpipe.sources",
    "lfpipe.commands",
    "lfpipe.stages",
    "lfpipe.requests",
)
log = logging.getLogger(__name__)
AND = " and "  # between packages that offer a plug-in of one name
Results = Mapping[str, type | UnionType]
T = TypeVar("T")


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


@contextlib.contextmanager
def _guarded(group: str, name: str, what: str) -> Iterator[None]:
    """Turns whatever another package's code raises, also SystemExit, into PluginError."""
    try:
        yield
    except (UserError, KeyboardInterrupt):
        raise
    except BaseException as error:
        failure = _broken(group, name, f"{what}: {type(error).__name__}: {error}")
        log.warning("%s", failure.message, exc_info=True)
        raise failure from None


def _broken(group: str, name: str, why: str) -> PluginError:
    package = plugins(group)[name]
    remedy = f"repair or uninstall {package.partition(' ')[0]}"
    return PluginError(name, f"{name} of {package} ({group}) {why}", remedy)


class Guarded:
    """A part of a plug-in: its calls raise PluginError, also for a result of a wrong type."""

    def __init__(self, part: Any, group: str, name: str, results: Results) -> None:
        self._part = part
        self._group = group
        self._name = name
        self._results = results

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(self._part, attribute)
        return functools.partial(self._call, attribute, value) if callable(value) else value

    def __str__(self) -> str:
        return str(self._part)

    def guard(self, part: Any, results: Results) -> Any:
        """`guarded` for a part that this one has made."""
        return guarded(part, self._group, self._name, results)

    def _call(
        self, attribute: str, function: Callable[..., Any], *arguments: Any, **named: Any
    ) -> Any:
        with _guarded(self._group, self._name, f"fails in {attribute}"):
            result = function(*arguments, **named)
        kind = self._results.get(attribute, object)
        if not isinstance(result, kind):
            raise _broken(
                self._group, self._name, f"returns {type(result).__name__} from {attribute}"
            )
        return result


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
        raise _broken(group, name, "has the name of a built-in one")
    if len(offers) > 1:
        raise _broken(group, name, "is offered twice")
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
            raise _broken(group, name, f"has no {attribute}")
        if not callable(value) and not isinstance(value, kind):
            raise _broken(group, name, f"has {type(value).__name__} as {attribute}")
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
                raise _broken(group, name, f"is {type(part).__name__}, not {kind.__name__}")
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
        try:
            working[name] = guarded(load(group, name, built_in), group, name, results)
        except PluginError as error:
            log.warning("%s; it is skipped", error.message)
    return working
