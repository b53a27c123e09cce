"""Share: sends the viewer's eyes and head, and the stamps of shown pictures, to other programs.

Reads: ring "eyes", in order; ring "shown", in order, if a target's protocol has pictures.
Writes: the targets of option "share" of the extras.
Commands: stop; targets by that option, camera.* by configuration. Asks: share (to end a target
that cannot be opened).
Emits: notice (a target fails, or works again).
"""

import time

import attrs
import numpy as np

from lfpipe.errors import UserError
from lfpipe.extras.share.output import LslOutput, Sample, UdpOutput
from lfpipe.extras.share.target import Target, check_target
from lfpipe.eyes import EYES, MAX_STEP_NS, SHOWN
from lfpipe.host.worker import yield_to_others
from lfpipe.track.eye_tracker import HeadEstimator
from lfpipe.transport.context import Context, RingInput
from lfpipe.transport.ring import Stamp, Ticker, now_ns


@attrs.define
class _Channel:
    """An open target."""

    target: Target
    output: UdpOutput | LslOutput
    ticker: Ticker | None
    """Due times of predicted eyes; None if every frame is sent."""
    works: bool = True


class Sharer:
    """The stage's work. Every method except `wait` returns at once, whatever receivers do."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._eyes = context.input("eyes")
        self._shown: RingInput | None = None  # once a target has pictures
        self._record, self._picture = np.zeros((), EYES), np.zeros((), SHOWN)
        self._stamp: Stamp | None = None
        self._estimator = HeadEstimator(context.config)
        self._channels: dict[str, _Channel] = {}

    def set_targets(self) -> None:
        """Opens and closes targets as the session's options require."""
        targets = self._context.options.extra("share")
        self._estimator.config = self._context.config
        for text in self._channels.keys() - targets:
            self._channels.pop(text).output.close()
        for text in targets:
            if text not in self._channels:
                self._open(text)

    def _open(self, text: str) -> None:
        context = self._context
        try:
            with context.busy_with("opening a target"):
                target = check_target(text)
                output: UdpOutput | LslOutput
                if target.kind == "lsl":
                    # liblsl's threads inherit it: many receivers do not delay a picture
                    yield_to_others()
                    self._shown = self._shown or context.input("shown")
                    output = LslOutput(
                        target,
                        context.spec.session.run,
                        context.options.viewer.rate_hz,
                        context.options.show,
                    )
                else:
                    output = UdpOutput(target)
        except (OSError, ImportError, RuntimeError, UserError) as error:
            context.notify(f"sharing with {text}: cannot be opened: {error}; nothing is sent there")
            context.request("share", stop=[text])
            return
        self._channels[text] = _Channel(
            target, output, Ticker(target.rate_hz, now_ns()) if target.rate_hz else None
        )

    def wait(self) -> bool:
        """Waits for a frame, a picture or the next due time; False when the stage must end."""
        due = [channel.ticker.due_ns() for channel in self._channels.values() if channel.ticker]
        return self._context.wait(min(due, default=None))

    def _send(self, channel: _Channel, stamp: Stamp, t_ns: int) -> None:
        """Sends the eyes at t_ns; reports the first failure, and the first success after it."""
        head = self._estimator.head(self._record, t_ns - stamp.t_sensor_ns)
        confidence = float(self._record["confidence"]) if head is not None else 0.0
        works = channel.output.send(
            Sample(stamp.source_seq, stamp.t_sensor_ns, t_ns, head, confidence)
        )
        self._context.row["drops"] += not works
        if works != channel.works:
            channel.works = works
            state = (
                "works again"
                if works
                else "the system does not send it: no route, or a full buffer"
            )
            self._context.notify(f"sharing with {channel.target}: {state}")

    def send_frames(self) -> None:
        """Sends the eyes of every new frame."""
        context = self._context
        while (stamp := self._eyes.take(self._record, in_order=True)) is not None:
            t_taken_ns = now_ns()
            self._stamp = stamp
            self._estimator.update(self._record, stamp.t_sensor_ns)
            for channel in self._channels.values():
                if channel.ticker is None:
                    self._send(channel, stamp, stamp.t_sensor_ns)
            t_sent_ns = now_ns()
            context.row.count_output(stamp.source_seq)
            context.row.record_latency(
                t_taken_ns - stamp.t_publish_ns,
                t_sent_ns - t_taken_ns,
                t_sent_ns - stamp.t_sensor_ns,
            )

    def send_predicted(self) -> None:
        """Sends predicted eyes that are due; none while no frames arrive."""
        for channel in self._channels.values():
            t_ns = now_ns()
            if channel.ticker is None or t_ns < channel.ticker.due_ns():
                continue
            channel.ticker.advance(t_ns)
            if self._stamp is not None and t_ns - self._stamp.t_sensor_ns < MAX_STEP_NS:
                self._send(channel, self._stamp, t_ns)

    def send_pictures(self) -> None:
        """Sends the stamps of shown pictures."""
        if self._shown is None:
            return
        while (stamp := self._shown.take(self._picture, in_order=True)) is not None:
            for channel in self._channels.values():
                if isinstance(channel.output, LslOutput):
                    channel.output.show(stamp.source_seq, self._picture)

    def close(self) -> None:
        """Closes all targets."""
        for channel in self._channels.values():
            channel.output.close()


def main(context: Context) -> None:
    """Runs the stage until it is stopped."""
    sharer = Sharer(context)
    sharer.set_targets()
    context.ready()
    context.ack_config()
    try:
        while sharer.wait():
            sharer.set_targets()
            context.ack_config()
            sharer.send_frames()
            sharer.send_predicted()
            sharer.send_pictures()
            context.row["cpu_ns"] = time.process_time_ns()
    finally:
        sharer.close()
