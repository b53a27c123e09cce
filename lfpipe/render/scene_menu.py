"""Key Tab: choosing a scene by its thumbnail. The old scene stays behind the thumbnails until the chosen one is packed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lfpipe.render.display import Display
from lfpipe.render.scene_loader import SceneLoader
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Reader

if TYPE_CHECKING:
    from lfpipe.render.thumbnails import Thumbnails

CAMERA_NS = SECOND_NS // 5


class SceneMenu:
    """The thumbnails of the playlist while the menu is open."""

    def __init__(self, context: Context, display: Display, scenes: SceneLoader) -> None:
        self._context, self._display, self._scenes = context, display, scenes
        self._open: Thumbnails | None = None
        self._camera: Reader | None = None
        self._camera_due_ns = 0

    def open(self) -> None:
        """Shows the thumbnails over the picture."""
        from lfpipe.render.thumbnails import Thumbnails  # few sessions need it

        options = self._context.options
        self._open = Thumbnails(options.playlist, options.playlist_at, self._context.config.scene, options.tracking)
        self._camera = Reader(self._context.spec.session.segment("frames")) if options.tracking else None
        self._display.menu(self._open.draw)

    def close(self) -> None:
        """Closes the menu."""
        if self._camera is not None:
            self._camera.close()
        self._open = self._camera = None
        self._display.menu(None)

    def takes(self, event: str) -> bool:
        """Handles an event of the window; returns whether it was for the menu."""
        if self._open is None:
            options = self._context.options
            if event != "choose" or not (len(options.playlist) > 1 or options.start):
                return False
            self.open()
        elif event == "choose":
            self.close()
        elif event == "glasses":
            self.close()
            return False
        elif event == "enter":
            self._choose(self._open.at)
        elif event.startswith("click "):
            x, y = map(int, event.split()[1:])
            if (number := self._open.scene_at(x, y)) is not None:
                self._choose(number)
        elif self._open.move(event):
            self._display.menu(self._open.draw)
        else:
            return False
        return True

    def _choose(self, number: int) -> None:
        assert self._open is not None
        scene = Path(self._open.scenes[number])
        self.close()
        self._scenes.load(scene)

    def serve(self, t_ns: int) -> None:
        """Reads one more thumbnail and, now and then, the camera's picture."""
        if self._open is None:
            return
        with self._context.busy_with("reading thumbnails"):
            changed = self._open.load_one()
        if self._camera is not None and t_ns >= self._camera_due_ns:
            self._camera_due_ns = t_ns + CAMERA_NS
            width_px, height_px = self._context.config.camera.frame_px
            frame = np.empty((height_px, width_px, 3), np.uint8)
            if self._camera.read(frame) is not None:
                self._open.camera(frame, "a face: here you are" if self._context.row["face"] else "no face seen")
                changed = True
        if changed:
            self._display.menu(self._open.draw)
