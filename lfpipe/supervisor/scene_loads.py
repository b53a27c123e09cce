"""The packers of a session: one works on the disparity of the scene on the screen, one on the scene
that a request wants.
"""

import logging
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import attrs

from lfpipe.config import Scene, SceneSummary
from lfpipe.scene.open_scene import PackerRequest, Packing
from lfpipe.supervisor.control_sockets import Request
from lfpipe.transport.clock import SECOND_NS, now_ns

logger = logging.getLogger(__name__)
STEP_NS = SECOND_NS // 5  # between two reports of progress
MAX_NAME_CHARS = 200  # more than a window has room for


@attrs.frozen
class SceneReady:
    """The wanted scene can be shown."""

    request: Request
    scene: SceneSummary


@attrs.frozen
class SceneComplete:
    """The scene on the screen has its disparity."""

    scene: SceneSummary


@attrs.frozen
class LoadFailed:
    """A packer refused its scene, or failed."""

    request: Request | None  # None for the scene on the screen
    error: Exception


SceneEvent = SceneReady | SceneComplete | LoadFailed


class _Load:
    """A packer at work, and what was reported of its progress."""

    def __init__(self, packing: Packing, request: Request | None) -> None:
        self.packing = packing
        self.request = request
        self.scene: SceneSummary | None = None  # once it is packed
        self._reported = ""
        self._report_ns = 0

    def news(self, end: bool = False) -> Iterator[dict[str, Any]]:
        """The message for the stage that shows pictures, if there is something new; step "" is the
        end.
        """
        packing = self.packing
        step = "" if end else packing.step
        if step != self._reported and (end or now_ns() >= self._report_ns + STEP_NS):
            self._reported = step
            self._report_ns = now_ns()
            name = Path(packing.subject).name[:MAX_NAME_CHARS]
            share = 1.0 if end else packing.share
            yield {
                "cmd": "loading",
                "scene": name,
                "step": step,
                "share": share,
                "shown": self.request is None,
            }


def _result(load: _Load, event: Callable[[SceneSummary], SceneEvent]) -> Iterator[SceneEvent]:
    """What the end of a packer means: the event of its scene, or of its failure."""
    try:
        load.scene = load.packing.summary()
    except Exception as error:  # who hears of it decides what to answer
        yield LoadFailed(load.request, error)
    else:
        yield event(load.scene)


class SceneLoads:
    """Both packers. report: receives their progress a few times a second, as a message. packing:
    the packer of the session's first scene, while it works.
    """

    def __init__(
        self, report: Callable[[dict[str, Any]], None], packing: Packing | None = None
    ) -> None:
        self._report = report
        self._shown = None if packing is None else _Load(packing, None)
        self._wanted: _Load | None = None

    def want(self, request: Request, path: str, settings: Scene) -> Request | None:
        """Begins to load a scene; returns the request that it replaces, if any."""
        replaced = self._end(self._wanted)
        self._wanted = None
        self._wanted = _Load(
            Packing(PackerRequest(scenes=[path], settings=settings, remember=True)), request
        )
        return replaced

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [fd for load in (self._shown, self._wanted) if load for fd in load.packing.fds]

    def update(self, connections: Collection[int]) -> list[SceneEvent]:
        """Reads what the packers have printed; returns what has happened. Ends the load of a client
        that is not among these connections any more.
        """
        if self._wanted and self._wanted.request.connection not in connections:  # type: ignore[union-attr]
            logger.info("load cancelled: its client is gone")
            self._end(self._wanted)
            self._wanted = None
        for load in (self._shown, self._wanted):
            if load is not None:
                load.packing.read()
                self._pass_on(load.news())
        return [*self._update_wanted(), *self._update_shown()]

    def _update_wanted(self) -> Iterator[SceneEvent]:
        load = self._wanted
        if load is None or load.request is None:
            return
        packing = load.packing
        request = load.request
        if packing.done:
            self._wanted = None
            yield from _result(load, lambda scene: SceneReady(request, scene))
            if load.scene is not None:
                self._end(self._shown)
                self._shown = None
            self._end(load)
        elif packing.views is not None:
            self._end(self._shown)
            self._pass_on(load.news(end=True))
            self._shown = _Load(packing, None)
            self._wanted = None
            yield SceneReady(request, packing.views)

    def _update_shown(self) -> Iterator[SceneEvent]:
        load = self._shown
        if load is not None and load.packing.done:
            self._shown = None
            yield from _result(load, SceneComplete)
            self._end(load)

    def _end(self, load: _Load | None) -> Request | None:
        """Ends a packer; that of a scene which the session has left: the next opening completes its
        pack. Returns its request.
        """
        if load is None:
            return None
        self._pass_on(load.news(end=True))
        load.packing.close()
        return load.request

    def _pass_on(self, news: Iterator[dict[str, Any]]) -> None:
        for message in news:
            self._report(message)

    def close(self) -> None:
        """Ends both packers."""
        self._end(self._shown)
        self._end(self._wanted)
        self._shown = self._wanted = None
