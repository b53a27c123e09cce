"""Other scenes, as the window asks for them: the next of the playlist, one that was dropped, the first for the next visitor.

The supervisor packs a scene while the old one stays in the picture; what was asked for meanwhile comes after it.
"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import attrs

from lfpipe.render.notices import Notices
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context

ALONE_NS = 60 * SECOND_NS  # after which the visitor is assumed to have left
NO_OTHER = "there is no other scene: `lfpipe up` accepts several"
REFUSED_NS, LINE_CHARS, MAX_LINES = 6 * SECOND_NS, 60, 5


@attrs.frozen
class _Request:
    """A scene that was asked for and is not there yet."""

    scene: str
    words: str
    since_ns: int


class SceneLoader:
    """Asks for scenes, and says in the picture what becomes of them."""

    def __init__(self, context: Context, notices: Notices) -> None:
        self._context, self._notices = context, notices
        self._loading: _Request | None = None
        self._next = ""  # scene to load after it
        self._step = "", ""  # what is loaded now, and how far it is
        self._first_due_ns = 0

    def step(self, step: int) -> None:
        """Another scene of the playlist, as far from the one that was asked for last."""
        scenes, asked = self._context.options.playlist, self._next or (self._loading.scene if self._loading else "")
        if len(scenes) < 2:
            self._notices.say("scene", NO_OTHER, now_ns())
            return
        at = scenes.index(asked) if asked in scenes else self._context.options.playlist_at
        self.load(Path(scenes[(at + step) % len(scenes)]))

    def load(self, scene: Path) -> None:
        """The scene at a path."""
        if self._loading:
            self._next = str(scene)
            return
        scenes = self._context.options.playlist
        place = f": {scenes.index(str(scene)) + 1} of {len(scenes)}" if str(scene) in scenes else ""
        self._context.request("load", scene=str(scene))
        self._loading = _Request(str(scene), f"loading {scene.name}{place}", now_ns())

    def answered(self, answer: dict[str, Any]) -> None:
        """Takes the answer to a request: what was refused stands in the picture for a while."""
        refused = not answer["ok"]
        if refused:
            what = f"{self._loading.words}: refused" if self._loading else "refused"
            lines = [what, *textwrap.wrap(answer["error"], LINE_CHARS)]
            self._notices.say("refused", "\n".join(lines[:MAX_LINES]), now_ns(), REFUSED_NS)
        if refused or "pack" in answer:
            self._loading = None
            if self._next:
                scene, self._next = self._next, ""
                self.load(Path(scene))

    def report_step(self, scene: str, step: str) -> None:
        """Takes how far a scene is loaded, whoever asked for it; "" at the end."""
        self._step = scene, step

    def serve(self, t_ns: int) -> None:
        """Says what is being loaded; in an exhibition the next visitor begins with the first scene."""
        waited_s = (t_ns - self._loading.since_ns) // SECOND_NS if self._loading else 0
        (scene, step), loading = self._step, self._loading
        words = loading.words if loading else f"loading {scene}" if step else ""
        self._notices.state("loading", ", ".join(filter(None, [words, step, f"{waited_s} s" if waited_s else ""])))
        options, alone_ns = self._context.options, t_ns - int(self._context.row["t_face_ns"])
        if options.kiosk and options.playlist_at and alone_ns > ALONE_NS and t_ns > self._first_due_ns:
            self._first_due_ns = t_ns + ALONE_NS  # it may have to be packed again
            self._context.request("load", at=0)
