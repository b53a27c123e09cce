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
lfpipe.commands   an `AddedCommand` or `AddedOption` of `lfpipe.cli.terminal`; its name is
                  COMMAND, GROUP.COMMAND or COMMAND.--OPTION
lfpipe.stages     a `lfpipe.transport.context.Stage`: a row of the process table
lfpipe.requests   a module or object with the methods of `lfpipe.supervisor.requests.RequestPlugin`;
                  the name is that of the control command
lfpipe.painters   a function of `render.device` and a thread that returns a
                  `lfpipe.render.synthesis.compositor.Painters`, or None, and what draws

Whatever the code of another package raises becomes a UserError that names group, entry point and
package. A plug-in with the name of a built-in part is not used.
"""

import contextlib
import functools
import importlib.metadata
import logging
import pkgutil
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from typing import Any

from lfpipe.errors import UserError

LAYOUTS = "lfpipe.layouts"
ENGINES = "lfpipe.engines"
FILTERS = "lfpipe.filters"
DISPLAYS = "lfpipe.displays"
SOURCES = "lfpipe.sources"
COMMANDS = "lfpipe.commands"
STAGES = "lfpipe.stages"
REQUESTS = "lfpipe.requests"
PAINTERS = "lfpipe.painters"
Part = tuple[str, str]  # a plug-in's group and name
IN_USE: list[Part] = []  # by this process: they may also cause what fails elsewhere


@functools.cache
def entries(group: str) -> dict[str, importlib.metadata.EntryPoint]:
    """The entry points of a group by name, in a fixed order, without those of a missing
    `lfpipe.extras`; the search of all installed packages takes milliseconds.
    """
    missing = () if find_spec("lfpipe.extras") else ("lfpipe.extras",)
    registered = importlib.metadata.entry_points(group=group)
    return {entry.name: entry for entry in registered if not entry.module.startswith(missing)}


def plugins(group: str) -> tuple[str, ...]:
    """The names of the plug-ins of a group. Imports none of them."""
    return tuple(entries(group))


@contextlib.contextmanager
def blaming(parts: Sequence[Part]) -> Iterator[None]:
    """Turns what the code of these plug-ins raises, also SystemExit, into a UserError that names
    them. Built-in parts among them are not blamed.
    """
    try:
        yield
    except (UserError, KeyboardInterrupt, BrokenPipeError):
        raise
    except BaseException as error:
        involved = [entries(group)[name] for group, name in parts if name in plugins(group)]
        if not involved:
            raise
        logging.getLogger(__name__).info("a plug-in failed", exc_info=True)
        names = [entry.dist.name if entry.dist else "its package" for entry in involved]
        texts = [
            f"{entry.name} of {name} {entry.dist.version if entry.dist else ''} ({entry.group})"
            for entry, name in zip(involved, names, strict=True)
        ]
        raise UserError(
            f"{', '.join(texts)}: {type(error).__name__}: {error}",
            f"repair or uninstall {' or '.join(names)}",
        ) from error


def load(group: str, name: str) -> Any:
    """The object of a plug-in. Raises UserError if there is none, or its package is broken."""
    if name not in plugins(group):
        raise UserError(f"{group}: {name!r} is not installed", "install the package that offers it")
    with blaming([(group, name)]):
        return entries(group)[name].load()


def load_target(group: str, name: str, target: str) -> Any:
    """The object at target, MODULE:NAME, which a plug-in names to be imported late.

    Raises UserError.
    """
    with blaming([(group, name)]):
        return pkgutil.resolve_name(target)


def make(group: str, name: str, *arguments: Any) -> Any:
    """What the function of a plug-in makes; it is in use from now on. Raises UserError."""
    function = load(group, name)
    IN_USE.append((group, name))
    with blaming([(group, name)]):
        return function(*arguments)
