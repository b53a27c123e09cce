"""Settings that a person changes in the window: the supervisor applies them, the window saves those
that are kept.
"""

from functools import partial
from typing import Any

import attrs

from lfpipe.config import Render, choices, user_file
from lfpipe.config.user_files import write_keys
from lfpipe.render.synthesis.viewpoint import zero_plane_px, zero_planes_px
from lfpipe.render.ui.files import Files
from lfpipe.render.ui.notices import Notices
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.context import Context

MODES = choices("render.anaglyph")
KEPT = {"anaglyph": "Glasses", "swap_eyes": "Eyes", "ghost_compensation": "Ghosts"}  # in a notice


class Settings:
    """Requests changes of [render] and of the order of depth."""

    def __init__(self, context: Context, viewer: Viewer, notices: Notices, files: Files) -> None:
        self._context = context
        self._notices = notices
        self._files = files
        self._viewer = viewer
        self._asked: dict[str, Any] = {}  # requested, and not yet applied
        self._unanswered = 0

    @property
    def render(self) -> Render:
        """The settings as they will be: keys may follow each other faster than they are applied."""
        return attrs.evolve(self._context.config.render, **self._asked)

    def set(self, **values: Any) -> None:
        """Changes keys of [render] until the session ends."""
        self._asked |= values
        self._request({f"render.{name}": value for name, value in values.items()})

    def answered(self) -> None:
        """Takes the answer to a change: it is applied now, or refused."""
        self._unanswered -= 1
        if not self._unanswered:
            self._asked.clear()

    def _request(self, values: dict[str, Any]) -> None:
        self._unanswered += 1
        self._context.request("set", set=values)

    def keep(self, values: dict[str, float | bool | str]) -> None:
        """Saves keys of [render] in the person's settings."""
        if values:
            names = ", ".join(KEPT.get(name, name) for name in values)
            self._files.do(
                partial(write_keys, user_file(), "render", values),
                lambda _: self._notices.show("kept", f"{names} saved"),
            )

    def next_mode(self) -> None:
        """Switches to the next colour mode."""
        at = MODES.index(self.render.anaglyph)
        self.set(anaglyph=MODES[(at + 1) % len(MODES)])

    def swap_eyes(self) -> None:
        """Swaps the views of the eyes."""
        self.set(swap_eyes=not self.render.swap_eyes)

    def invert_depth(self) -> None:
        """Inverts the depth of the scene."""
        word = "no" if self._viewer.field.depth_inverted else "yes"
        self._request({"scene.invert_depth": word})

    def automatic(self) -> None:
        """Makes depth and parallax automatic again."""
        default = Render()
        self.set(alpha_px="auto", zero_plane_px=default.zero_plane_px, depth=default.depth)

    def move_zero_plane(self, steps: int) -> None:
        """Moves the scene back (steps > 0) or forward."""
        field = self._viewer.field
        *_, step_px = zero_planes_px(field.disparity_min_px, field.disparity_max_px)
        number = round(zero_plane_px(field, self.render) / step_px) + steps
        self.set(zero_plane_px=round(number * step_px, 6))

    def scale_alpha(self, factor: float) -> None:
        """Multiplies alpha."""
        if self._viewer.parallax is not None:
            self.set(alpha_px=round(self._viewer.parallax.alpha_px * factor, 3))
