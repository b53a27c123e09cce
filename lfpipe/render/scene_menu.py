"""Other scenes: requests for the next of the playlist or a dropped one, and the choice by thumbnails (key Tab).

The old scene stays on the screen until the packer has the views of the new one. A second request replaces the first.
"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from lfpipe.render.display import Display
from lfpipe.render.overlay import Notices
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Reader

ALONE_NS = 60 * SECOND_NS  # then the visitor is assumed to have left
NO_OTHER = "there is no other scene: `lfpipe up` accepts several"
REFUSED_NS, LINE_CHARS, MAX_LINES = 6 * SECOND_NS, 60, 5


@attrs.frozen
class _Request:
    """A requested scene that is not loaded yet."""

    scene: str
    words: str
    since_ns: int


class SceneLoader:
    """Requests scenes and shows the progress in the picture."""

    def __init__(self, context: Context, notices: Notices) -> None:
        self._context, self._notices = context, notices
        self._loading: _Request | None = None
        self._step = "", ""  # the scene being loaded and its progress
        self.share: float | None = None  # of the packer's work on the scene on the screen that is done; None without
        self._first_due_ns = 0

    def step(self, step: int) -> None:
        """Requests the scene of the playlist that many steps from the one requested last."""
        scenes, asked = self._context.options.playlist, self._loading.scene if self._loading else ""
        if len(scenes) < 2:
            self._notices.say("scene", NO_OTHER, now_ns())
            return
        at = scenes.index(asked) if asked in scenes else self._context.options.playlist_at
        self.load(Path(scenes[(at + step) % len(scenes)]))

    def load(self, scene: Path) -> None:
        """Requests the scene at a path, instead of one requested before."""
        scenes = self._context.options.playlist
        place = f": {scenes.index(str(scene)) + 1} of {len(scenes)}" if str(scene) in scenes else ""
        self._context.request("load", scene=str(scene))
        self._loading = _Request(str(scene), f"loading {scene.name}{place}", now_ns())

    def answered(self, answer: dict[str, Any]) -> None:
        """Handles the answer to a request: the picture shows a refusal for a while."""
        if answer.get("replaced"):
            return
        refused = not answer["ok"]
        if refused:
            what = f"{self._loading.words}: refused" if self._loading else "refused"
            lines = [what, *textwrap.wrap(answer["error"], LINE_CHARS)[:MAX_LINES]]
            lines += textwrap.wrap(answer.get("remedy", ""), LINE_CHARS)
            self._notices.say("refused", "\n".join(lines[: 2 * MAX_LINES]), now_ns(), REFUSED_NS)
        if refused or "pack" in answer:
            self._loading = None

    def report(self, news: dict[str, Any]) -> None:
        """Takes the progress of loading, whoever requested the scene. Of the scene on the screen, only a bar shows it."""
        self._step = ("", "") if news["shown"] else (news["scene"], news["step"])
        self.share = news["share"] if news["shown"] and news["step"] else None

    def serve(self, t_ns: int) -> None:
        """Shows what is being loaded; in an exhibition, requests the first scene for the next visitor."""
        waited_s = (t_ns - self._loading.since_ns) // SECOND_NS if self._loading else 0
        (scene, step), loading = self._step, self._loading
        words = loading.words if loading else f"loading {scene}" if step else ""
        self._notices.state("loading", ", ".join(filter(None, [words, step, f"{waited_s} s" if waited_s else ""])))
        options, alone_ns = self._context.options, t_ns - int(self._context.row["t_face_ns"])
        if options.kiosk and options.playlist_at and alone_ns > ALONE_NS and t_ns > self._first_due_ns:
            self._first_due_ns = t_ns + ALONE_NS  # it may need packing again
            self._context.request("load", at=0)


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
        self._forgotten: set[str] = set()  # scenes taken off the start page

    def open(self) -> None:
        """Shows the thumbnails over the picture."""
        from lfpipe.render.thumbnails import Thumbnails  # few sessions need it

        options = self._context.options
        scenes = [scene for scene in options.playlist if scene not in self._forgotten]
        at = scenes.index(now) if (now := options.playlist[options.playlist_at]) in scenes else 0
        self._open = Thumbnails(scenes, at, self._context.config.scene, options.tracking)
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
        elif event == "delete":
            self._forget()
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

    def _forget(self) -> None:
        """Takes the selected scene off the start page; the demo stays, and so do all files."""
        assert self._open is not None
        if not self._context.options.start or not self._open.at:
            return
        from lfpipe.scene.recent_scenes import forget_scene

        scene = self._open.remove()
        self._forgotten.add(scene)
        forget_scene(Path(scene))
        self._display.menu(self._open.draw)

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
                options, seen = self._context.options, "a face: here you are" if self._context.row["face"] else "no face seen"
                demo = "demo face: no camera found" if options.start else "demo face"
                caption = demo if options.source.startswith("demo") else seen
                self._open.camera(frame, caption)
                changed = True
        if changed:
            self._display.menu(self._open.draw)
