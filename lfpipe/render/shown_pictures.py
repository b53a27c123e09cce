"""Pictures between hand-over and light: each waits for the blank that showed it, and is reported in its order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import attrs

from lfpipe.host.presentation import Presented
from lfpipe.transport.clock import MS_NS

ANSWER_NS = 250 * MS_NS  # a hidden window gets no answer
HANDOVER, REPLACED = "handover", "replaced"

Report = Callable[[int, str], None]  # (t_presented_ns, who reported it)


@attrs.define
class _Picture:
    number: int  # -1: the picture on the screen stays for this refresh
    t_handed_ns: int
    report: Report
    t_presented_ns: int = 0
    by: str = ""


class ShownPictures:
    """Ask `take` often; it reports every picture once, by the time of its blank, or of its hand-over where nobody tells."""

    def __init__(self) -> None:
        self._waiting: deque[_Picture] = deque()

    def add(self, number: int, t_handed_ns: int, report: Report) -> None:
        """Picture `number` was handed over."""
        self._waiting.append(_Picture(number, t_handed_ns, report))

    def stays(self, t_ns: int, by: str, report: Report) -> None:
        """The picture on the screen is shown for another refresh, at t_ns."""
        self._waiting.append(_Picture(-1, t_ns, report, t_ns, by))

    def take(self, answers: list[Presented], by: str, t_ns: int) -> None:
        """Takes what the window system answered, and reports what is known at t_ns."""
        found = {each.number: each for each in self._waiting if each.number >= 0}
        for answer in answers:
            picture = found.get(answer.serial)
            if picture is not None and not picture.by:
                # one that was never shown has no blank: its hand-over stands
                picture.t_presented_ns, picture.by = (answer.t_ns, by) if answer.t_ns else (picture.t_handed_ns, REPLACED)
        while self._waiting and (self._waiting[0].by or t_ns - self._waiting[0].t_handed_ns > ANSWER_NS):
            picture = self._waiting.popleft()
            picture.report(picture.t_presented_ns or picture.t_handed_ns, picture.by or HANDOVER)

    def flush(self) -> None:
        """Reports all that is left."""
        while self._waiting:
            picture = self._waiting.popleft()
            picture.report(picture.t_presented_ns or picture.t_handed_ns, picture.by or HANDOVER)
