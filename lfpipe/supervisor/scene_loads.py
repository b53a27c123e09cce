"""The packers of a session: one for the disparity of the scene on screen, one for a requested
scene.
"""

from collections.abc import Callable, Mapping

import attrs

from lfpipe.config import SceneSummary
from lfpipe.scene.open_scene import PackerRequest, Packing
from lfpipe.supervisor.control_sockets import Request
from lfpipe.transport.control import Message
from lfpipe.transport.ring import SECOND_NS, now_ns

STEP_NS = SECOND_NS // 5  # between two reports of progress
WANTED, SHOWN = "wanted", "shown"  # scenes: of a request, and on the screen
Send = Callable[[Message], None]  # to the stage that shows pictures


@attrs.frozen
class SceneEvent:
    """A result of a packer."""

    request: Request | None
    """The request for the scene; None for the scene on the screen."""
    scene: SceneSummary | Exception
    """The scene, ready to be shown, or the error."""
    scenes: list[str] = attrs.field(factory=list)
    """The light fields in the requested path; the scene is the first."""
    unusable: Mapping[str, str] = attrs.field(factory=dict)
    """Those that cannot be opened, and why."""
    note: str = ""
    """What a person should know about the rest of a folder."""


class _Load:
    """A running packer, and its last reported progress."""

    def __init__(self, packing: Packing, send: Send, request: Request | None = None) -> None:
        self.packing = packing
        self.request = request
        self._send = send
        self._reported = ""
        self._report_ns = 0

    def report(self, end: bool = False) -> None:
        """Sends the step of the packer if it is new; at the end, sends "" immediately."""
        step = "" if end else self.packing.step
        if step == self._reported or not (end or now_ns() >= self._report_ns + STEP_NS):
            return
        self._reported = step
        self._report_ns = now_ns()
        self._send(
            {
                "cmd": "loading",
                "scene": (self.packing.scenes or [self.packing.subject])[0],
                "step": step,
                "share": 1.0 if end else self.packing.share,
                "shown": self.request is None,
            }
        )

    def event(self) -> SceneEvent | None:
        """The event, if the packer has ended or a wanted scene can be shown."""
        packing = self.packing
        scene: SceneSummary | Exception | None = packing.views if self.request else None
        if packing.done:
            try:
                scene = packing.summary()
            except Exception as error:  # the client's answer
                scene = error
                for path in packing.scenes[:1]:  # the packer may have crashed
                    packing.unusable.setdefault(path, str(error).partition("\n")[0])
        if scene is None:
            return None
        return SceneEvent(self.request, scene, packing.scenes, packing.unusable, packing.note)


class SceneLoads:
    """The packers of both scenes. send: for their progress, a few times a second."""

    def __init__(self, send: Send, packing: Packing | None = None) -> None:
        """packing: the packer of the session's first scene, while it works."""
        self._send = send
        self._loads = {} if packing is None else {SHOWN: _Load(packing, send)}

    def want(self, request: Request, scene: PackerRequest) -> Request | None:
        """Starts to load a scene; returns the request that it replaces, if any. Raises UserError if
        no packer can be started; the one that runs then goes on.
        """
        load = _Load(Packing(scene), self._send, request)
        replaced = self._loads.get(WANTED)
        self._end(WANTED)
        self._loads[WANTED] = load
        return None if replaced is None else replaced.request

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [fd for load in self._loads.values() for fd in load.packing.fds]

    def events(self) -> list[SceneEvent]:
        """Reads the packers' output; returns the events."""
        events = []
        for name in (WANTED, SHOWN):
            load = self._loads.get(name)
            if load is None:
                continue
            load.packing.read()
            load.report()
            event = load.event()
            if event is None:
                continue
            events.append(event)
            if isinstance(event.scene, SceneSummary):
                self._end(SHOWN)
            if event.scene is load.packing.views:  # the packer continues with its disparity
                load.report(end=True)
                self._loads = {SHOWN: _Load(load.packing, self._send)}
            else:
                self._end(name)
        return events

    def _end(self, name: str) -> None:
        """Ends a packer. If its pack is incomplete, the next opening completes it."""
        if load := self._loads.pop(name, None):
            load.report(end=True)
            load.packing.close()

    def close(self) -> None:
        """Ends both packers."""
        for name in list(self._loads):
            self._end(name)
