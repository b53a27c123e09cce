"""Small pictures of scenes, for the page that offers them: the packer reads them, another one from
the next scene on where a scene ends it.
"""

import logging
from collections.abc import Callable, Sequence
from typing import Any

import attrs

from lfpipe.config import Scene
from lfpipe.host.worker import Worker
from lfpipe.scene.open_scene import SILENT_S, PackerRequest

logger = logging.getLogger(__name__)


class _Reader(Worker):
    """The packer at work on previews. taken: how many scenes have had their turn."""

    def __init__(self, scenes: Sequence[str], settings: Scene) -> None:
        self.scenes = scenes
        self.previews: list[dict[str, Any]] = []
        self.taken = 0
        request = PackerRequest(do="previews", scenes=scenes, settings=settings)
        super().__init__("lfpipe.render.packer", attrs.asdict(request), scenes[0], SILENT_S)

    def on_step(self, step: dict[str, Any]) -> None:
        """Keeps a preview; the packer also tells what it decided."""
        if "preview" in step:
            self.taken += 1
            self.previews.append(step)


class ScenePreviews:
    """Reads the previews of one page. report: receives them as messages, "" for none."""

    def __init__(self, report: Callable[[dict[str, Any]], None]) -> None:
        self._report = report
        self._settings = Scene()
        self._reader: _Reader | None = None

    def begin(self, scenes: Sequence[str], settings: Scene) -> None:
        """Reads these scenes, in their order, instead of those before."""
        self.close()
        self._settings = settings
        if scenes:
            self._reader = _Reader(scenes, settings)

    @property
    def fds(self) -> Sequence[int]:
        """Descriptors that wake the supervisor."""
        return () if self._reader is None else self._reader.fds

    def update(self) -> None:
        """Passes on what was read; goes on with the next scene where one ends the child."""
        reader = self._reader
        if reader is None:
            return
        reader.read()
        for preview in reader.previews:
            self._report({"cmd": "preview", "scene": preview["preview"], "data": preview["data"]})
        reader.previews.clear()
        if reader.done:
            self.begin(reader.scenes[reader.taken + 1 :], self._settings)

    def close(self) -> None:
        """Ends the child."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None
