"""Other scenes on request: the next of the playlist, a dropped one, or the first for the next visitor.

The supervisor packs a scene while the old one stays on the screen; a request made meanwhile follows.
"""

import textwrap
from pathlib import Path
from typing import Any

import attrs

from lfpipe.render.notices import Notices
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context

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
        self._next = ""  # scene to load next
        self._step = "", ""  # the scene being loaded and its progress
        self._first_due_ns = 0

    def step(self, step: int) -> None:
        """Requests the scene of the playlist that many steps from the one requested last."""
        scenes, asked = self._context.options.playlist, self._next or (self._loading.scene if self._loading else "")
        if len(scenes) < 2:
            self._notices.say("scene", NO_OTHER, now_ns())
            return
        at = scenes.index(asked) if asked in scenes else self._context.options.playlist_at
        self.load(Path(scenes[(at + step) % len(scenes)]))

    def load(self, scene: Path) -> None:
        """Requests the scene at a path."""
        if self._loading:
            self._next = str(scene)
            return
        scenes = self._context.options.playlist
        place = f": {scenes.index(str(scene)) + 1} of {len(scenes)}" if str(scene) in scenes else ""
        self._context.request("load", scene=str(scene))
        self._loading = _Request(str(scene), f"loading {scene.name}{place}", now_ns())

    def answered(self, answer: dict[str, Any]) -> None:
        """Handles the answer to a request: the picture shows a refusal for a while."""
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
        """Reports the progress of loading, whoever requested the scene; "" at the end."""
        self._step = scene, step

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
