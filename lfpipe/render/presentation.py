"""Presentations: what each refresh shows, and pictures between submission and vblank, which are
reported in order.
"""

from collections import deque
from collections.abc import Iterable
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.host.presentation import Presented
from lfpipe.render.choice import DisplayTime, TrackedEyes
from lfpipe.render.viewer.viewer import Viewpoints
from lfpipe.transport.clock import MS_NS

ANSWER_NS = 250 * MS_NS  # a hidden window gets no report
HANDOVER, REPLACED = "handover", "replaced"


@attrs.define(kw_only=True)
class Presentation:
    """What one refresh, or one camera frame, showed."""

    seq: int
    """Counts presentations, over all restarts of the stage."""
    number: int
    """Number of the picture, from 1; 0: no new picture."""
    display_time: DisplayTime
    eyes: TrackedEyes | None
    """The eyes it was made for; None: no record yet."""
    viewpoints: Viewpoints
    picture: NDArray[np.uint8] | None
    """The picture on the screen, uint8 (height, width, 3) BGR; valid until the next one."""
    t_started_ns: int
    t_composed_ns: int
    t_handed_ns: int
    cost_ns: int
    """Time of composing and submission; 0: no new picture."""
    t_presented_ns: int = 0
    """0: never seen, or not known yet."""
    by: str = ""
    """The protocol that reported t_presented_ns, HANDOVER or REPLACED; empty: not known yet."""
    juddered: bool = False
    """Whether it was shown at another vblank than planned."""
    more: dict[str, Any] = attrs.field(factory=dict)
    """Fields that a listener adds to its line of the trace."""

    @property
    def composed(self) -> bool:
        """Whether it was a new picture."""
        return self.number > 0

    @property
    def face(self) -> bool:
        """Whether it was made for a face."""
        return self.eyes is not None and bool(self.eyes.record.face)

    @property
    def due_ns(self) -> int:
        """The refresh that it was made for; 0 for none."""
        return self.display_time.target_ns if self.display_time.refresh_ns else 0


class Listener:
    """Reacts to presentations; a listener defines only the methods that it needs."""

    def set_options(self, options: SessionOptions) -> None:
        """Sets the session's options: called before the first presentation and when they change."""

    def handed_over(self, presentation: Presentation) -> None:
        """Receives a presentation that was submitted to the display."""

    def presented(self, presentation: Presentation) -> None:
        """Receives a presentation whose display time is known; each is submitted first."""

    def close(self) -> None:
        """Closes its outputs."""


def take_known(
    waiting: deque[Presentation], answers: Iterable[Presented], by: str, t_ns: int
) -> list[Presentation]:
    """Takes the presentations, in order, whose display time is known at t_ns: their vblank, 0 if
    the next picture replaced them before it, or their submission without a report within ANSWER_NS.
    by: the protocol that reports; already set if a refresh repeated the picture on the screen.
    """
    unanswered = {
        presentation.number: presentation
        for presentation in waiting
        if presentation.composed and not presentation.by
    }
    for answer in answers:
        if (presentation := unanswered.get(answer.serial)) is not None:
            presentation.t_presented_ns = answer.t_ns
            presentation.by = by if answer.t_ns else REPLACED
    known = []
    while waiting and (waiting[0].by or t_ns - waiting[0].t_handed_ns > ANSWER_NS):
        known.append(presentation := waiting.popleft())
        if not presentation.by:
            presentation.t_presented_ns = presentation.t_handed_ns
            presentation.by = HANDOVER
    return known
