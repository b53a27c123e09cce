"""Pictures between hand-over and light: each waits for its blank and is reported in order."""

from collections import deque
from collections.abc import Callable

import attrs

from lfpipe.host.presentation import Presented
from lfpipe.transport.clock import MS_NS

ANSWER_NS = 250 * MS_NS  # a hidden window gets no report
HANDOVER, REPLACED = "handover", "replaced"

Report = Callable[[int, str], None]  # (t_presented_ns, the protocol that reported it)


@attrs.define
class _Picture:
    number: int  # -1: the picture on the screen stays for this refresh
    t_handed_ns: int
    report: Report
    t_presented_ns: int = 0
    by: str = ""


class ShownPictures:
    """Call `take` often: it reports every picture once, with the time of its blank, or of its hand-over if blanks are not
    reported, or 0 if the next picture replaced it before a blank."""

    def __init__(self) -> None:
        self._waiting: deque[_Picture] = deque()

    def add(self, number: int, t_handed_ns: int, report: Report) -> None:
        """Adds picture `number`, which was handed over."""
        self._waiting.append(_Picture(number, t_handed_ns, report))

    def stays(self, t_ns: int, by: str, report: Report) -> None:
        """Adds a refresh at t_ns that repeats the picture on the screen."""
        self._waiting.append(_Picture(-1, t_ns, report, t_ns, by))

    def take(self, answers: list[Presented], by: str, t_ns: int) -> None:
        """Takes the window system's reports and returns what is known at t_ns."""
        found = {each.number: each for each in self._waiting if each.number >= 0}
        for answer in answers:
            picture = found.get(answer.serial)
            if picture is not None and not picture.by:
                picture.t_presented_ns, picture.by = (answer.t_ns, by) if answer.t_ns else (0, REPLACED)
        while self._waiting and (self._waiting[0].by or t_ns - self._waiting[0].t_handed_ns > ANSWER_NS):
            self._report_first()

    def flush(self) -> None:
        """Reports all remaining pictures."""
        while self._waiting:
            self._report_first()

    def _report_first(self) -> None:
        picture = self._waiting.popleft()
        if picture.by:
            picture.report(picture.t_presented_ns, picture.by)
        else:
            picture.report(picture.t_handed_ns, HANDOVER)
