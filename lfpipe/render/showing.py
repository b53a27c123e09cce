"""What each refresh showed, and pictures between hand-over and light: each waits for its blank and is reported in order."""

from collections import deque
from collections.abc import Iterable
from typing import Any

import attrs

from lfpipe.eyes import EyesRecord
from lfpipe.host.presentation import Presented
from lfpipe.render.viewer import Viewpoints
from lfpipe.transport.clock import MS_NS
from lfpipe.transport.ring import Stamp, StampKind

ANSWER_NS = 250 * MS_NS  # a hidden window gets no report
HANDOVER, REPLACED = "handover", "replaced"


@attrs.define
class Showing:
    """What one refresh, or one camera frame, showed. number: of the picture; 0: the one on the screen stayed. stamp, record: of
    the frame it was made for; None: nobody was seen yet. target_ns: the refresh it was made for, 0 for none; seen_ns: when a
    viewer sees it, loop_ns of it for camera and display. t_presented_ns: 0: never seen, or not known yet; by: the protocol that
    reported it, empty: not known yet. more: additional fields of its line."""

    number: int
    stamp: Stamp | None
    record: EyesRecord | None
    viewpoints: Viewpoints
    seq: int
    target_ns: int
    seen_ns: int
    loop_ns: int
    t_sensor_ns: int
    t_started_ns: int
    t_composed_ns: int
    t_handed_ns: int
    waited_ns: int
    cost_ns: int
    t_presented_ns: int = 0
    by: str = ""
    more: dict[str, Any] = attrs.field(factory=dict)

    @property
    def face(self) -> int:
        return self.record.face if self.record is not None else 0

    def line(self, stamp: Stamp, method: str, level: int) -> dict[str, Any]:
        """The line of a trace (docs/contracts.md). stamp: of the frame."""
        assert self.record is not None
        used, raw = self.viewpoints.eyes_px, self.record.raw_px
        line = {
            "seq": self.seq,
            "source_seq": stamp.source_seq,
            "epoch": stamp.epoch,
            "t_sensor_ns": stamp.t_sensor_ns,
            "t_read_ns": stamp.t_read_ns,
            "stamp": StampKind(stamp.kind).word,
            "t_tracked_ns": self.record.t_tracked_ns,
            "t_started_ns": self.t_started_ns,
            "t_composed_ns": self.t_composed_ns,
            "t_presented_ns": self.t_presented_ns,
            "face": bool(self.face),
            "eyes_raw": {"left": raw[:2], "right": raw[2:]},
            "eyes_used": {"left": used[:2], "right": used[2:]},
            "view": {"left": list(self.viewpoints.left), "right": list(self.viewpoints.right)},
            "method": method,
            "level": level,
            "composed": self.number > 0,
            **self.more,
        }
        if self.by:
            line["presented_by"] = self.by
        return line


def take_known(
    waiting: deque[Showing], answers: Iterable[Presented], by: str, t_ns: int
) -> list[Showing]:
    """Takes those, in their order, whose time of display is known at t_ns: their blank, 0 if the next picture replaced them
    before one, or their hand-over if no report came within ANSWER_NS. by: the protocol that reports; it is set already where a
    refresh repeated the picture on the screen."""
    unanswered = {
        showing.number: showing for showing in waiting if showing.number and not showing.by
    }
    for answer in answers:
        if (showing := unanswered.get(answer.serial)) is not None:
            showing.t_presented_ns, showing.by = answer.t_ns, by if answer.t_ns else REPLACED
    known = []
    while waiting and (waiting[0].by or t_ns - waiting[0].t_handed_ns > ANSWER_NS):
        known.append(showing := waiting.popleft())
        if not showing.by:
            showing.t_presented_ns, showing.by = showing.t_handed_ns, HANDOVER
    return known
