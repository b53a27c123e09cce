"""Render: one picture for each refresh of the display, or for each camera frame.

Reads: ring "eyes", the newest record; the packed scene named by option "pack", or the rings "views"
and "disparity" of a live one.
Writes: the display of option "display"; the trace of option "trace"; the last picture to option
"still"; without a camera, ring "eyes" from the mouse, and recordings of them; for a live scene,
ring "viewpoints".
Commands: recentre, trace, record, loading (progress), stop; settings and another scene by
configuration, a lowered quality by option "level".
Asks: set, keep, costs, recentre, load, pause, resume, record, stop (events of the
window).
Emits: parallax (alpha and its reasons), viewer (nobody, arriving, seated, lost, exchanged), notice
(an output was lost).
"""

import logging
import math
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from lfpipe.config import Config, SessionOptions
from lfpipe.config.quality import lowered
from lfpipe.config.session_options import (
    Lossless,
    MouseViewer,
    Nothing,
    Plugin,
    RecordedEyes,
    VideoFile,
    Window,
    device_latency_ms,
)
from lfpipe.errors import UserError
from lfpipe.eyes import EYES, EyesRecord
from lfpipe.files.safe_files import check_output
from lfpipe.host.files import readable
from lfpipe.host.worker import run_on
from lfpipe.plugins import IN_USE, blaming
from lfpipe.render.display.display import Pointer, open_display
from lfpipe.render.display.file_display import save
from lfpipe.render.display.refresh import Refresh, ScreenRefresh
from lfpipe.render.listeners import (
    LiveRow,
    PictureRing,
    ReplayWriter,
    ShownStamps,
    StatusRow,
    TapMessages,
    Trace,
)
from lfpipe.render.live_input import LiveInput
from lfpipe.render.motion_latency import MotionLatency
from lfpipe.render.plan import measure_costs
from lfpipe.render.presenter import DisplayTime, EyesSource, Listener, Presenter
from lfpipe.render.synthesis.compositor import Painters, open_painters
from lfpipe.render.ui.controller import Ui
from lfpipe.render.ui.settings import Files
from lfpipe.render.viewer.mouse_look import MouseLook
from lfpipe.render.viewer.presence import ViewerState
from lfpipe.render.viewer.viewer import Canvas, Viewer
from lfpipe.scene.lightfield import remember, shown_as
from lfpipe.scene.pack import open_pack
from lfpipe.sequence.recorder import Recorder
from lfpipe.transport.context import BEAT_NS, Context
from lfpipe.transport.control import Message
from lfpipe.transport.ring import MS_NS, SECOND_NS, Stamp, now_ns
from lfpipe.transport.status import ENDED

logger = logging.getLogger(__name__)
TRACK = "track"  # the stage that writes the ring "eyes" unless the mouse is the viewer
# without a change, refreshes need no picture; the viewpoint is checked this often for the next
REST_AFTER_NS, REST_NS = SECOND_NS, SECOND_NS // 2


class RenderStage:
    """The scene, its viewer and its display, under the configuration in force."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._apply_settings()
        options = context.options
        self._lossless = isinstance(options.clock, Lossless)
        self._files = Files(context)
        count = len(context.cores)
        self._preparer = None if self._lossless else self._threads(1, "prepare")
        self._costs: Future[Mapping[str, float]] | None = None
        self._live: LiveInput | None = None
        with context.setting_up("opening the scene"):
            if options.live is not None and options.scene is not None:
                self._live = LiveInput(context, options.live, options.scene.name)
                self._field = self._live.store.field
            else:
                self._field = open_pack(Path(options.pack), self._config.scene.invert_depth)
        # without a clock, pictures depend on the frames alone
        on_camera = options.viewer.tracked and (
            self._lossless or self._config.render.clock == "camera"
        )
        self._display = open_display(
            options.display,
            (self._field.width_px, self._field.height_px),
            f"lfpipe: {self._field.name}",
            float(
                options.viewer.rate_hz if on_camera else self._requested_config.render.nominal_hz
            ),
            str(self._config.screen.monitor),
            context.row["restarts"],
        )
        self._display.waiting = partial(context.busy_with, "waiting for the screen")
        self._gpu = self._open_gpu()
        with context.setting_up("opening the scene"):
            self._viewer = Viewer(
                self._field,
                self._config,
                self._share,
                sways_alone=bool(options.lock_code),
                neutral_is_fixed=isinstance(options.viewer, MouseViewer | RecordedEyes),
                canvas=Canvas(
                    # in a replay, pictures are compared
                    shown_px=(lambda size_px: size_px)
                    if self._lossless
                    else self._display.shown_px,
                    helpers=self._threads(count - 1, "rows") if count > 1 else None,
                    cores=count,
                    gpu=self._gpu,
                    preparer=self._preparer,
                ),
            )
        self._store_choice()
        self._interactive = isinstance(options.display, Window | Plugin)
        self._serve_ns = self._rest_until_ns = 0
        self._viewer.set_width(self._display.width_mm())
        self._eyes = EyesSource(self._lossless)
        self._eyes_ring = context.input("eyes")
        self._record = np.empty((), EYES)
        self._is_pending = False  # whether no picture was made yet for the newest record
        self._mouse = MouseLook(
            context.config,
            self._viewer,
            context.output("eyes") if isinstance(options.viewer, MouseViewer) else None,
        )
        self._follow_mouse()
        self._status = StatusRow(context.row, self._viewer, self._display)
        self._listeners = self._make_listeners()
        self._refresh: Refresh | None = None
        if not on_camera:  # by the vblanks of the screen if it reports them, else even
            clock = ScreenRefresh if self._display.vblank_source else Refresh
            self._refresh = clock(self._config.render.nominal_hz, now_ns())
        self._presenter = Presenter(
            viewer=self._viewer,
            source=self._eyes,
            mouse=self._mouse,
            display=self._display,
            refresh=self._refresh,
            listeners=self._listeners,
            seq=context.row["seq"],
        )
        self._ui = Ui(
            context, self._viewer, self._presenter, self._mouse, self._display, self._files
        )
        middle = ((self._field.rows - 1) / 2, (self._field.cols - 1) / 2)
        # builds tables and touches pages before the first picture is due
        self._viewer.compositor.compose(middle, middle)
        self._measure_costs()
        context.row["t_face_ns"] = now_ns()

    def _threads(self, count: int, name: str) -> ThreadPoolExecutor:
        """Threads on any core."""
        return ThreadPoolExecutor(count, name, run_on, (self._context.cores,))

    def _open_gpu(self) -> Painters | None:
        """The GPU, by the configuration; a replay has one only if asked to, because its pictures
        are compared.
        """
        device = self._config.render.device
        painter = "cpu" if self._lossless and device == "auto" else device
        gpu, words = open_painters(painter, self._threads(1, "gpu"))
        logger.info("drawing by the %s", words)
        if device == "gpu" and gpu is None:
            self._context.notify(f"render.device gpu: pictures are drawn by the {words}")
        self._context.row["gpu"] = gpu is not None
        return gpu

    def _report_gpu(self) -> None:
        if self._gpu is not None and self._gpu.failure:
            self._context.notify(
                f"the GPU draws no longer ({self._gpu.failure}); pictures are drawn by the CPU"
            )
            self._context.row["gpu"] = False
            self._gpu = None

    def _measure_costs(self) -> None:
        """Begins to measure what pictures cost, beside the pictures."""
        if self._preparer is not None and self._requested_config.governor.quality == "auto":
            self._costs = self._preparer.submit(
                measure_costs, self._field, self._requested_config.render, self._gpu
            )

    def _report_costs(self) -> None:
        if self._costs is not None and self._costs.done():
            size_px = self._field.width_px, self._field.height_px
            self._context.request(
                "costs",
                ns_per_px=self._costs.result(),
                picture_px=min(math.prod(self._display.shown_px(size_px)), math.prod(size_px)),
                cores=len(self._context.cores),
            )
            self._costs = None

    def _apply_settings(self) -> None:
        """Applies the current configuration and options of the context."""
        self._requested_config = self._context.config
        self._options = options = self._context.options
        self._config: Config = lowered(self._requested_config, options)
        self._share = options.level.size if options.level else 1.0
        # Of camera and display together. A file has no display, and without a clock
        # replay.latency_ms is the whole delay.
        self._device_latency_ns = int(
            device_latency_ms(options.clock, self._config.render.device_latency_ms) * MS_NS
        )
        if isinstance(options.display, VideoFile):
            self._device_latency_ns = 0

    def _make_listeners(self) -> list[Listener]:
        context, options = self._context, self._options
        session = context.spec.session
        listeners: list[Listener] = [self._status]
        if not isinstance(options.display, Nothing):
            listeners.append(MotionLatency(context.row))
        if replay := options.clock.output:
            listeners.append(
                ReplayWriter(Path(replay.folder), replay.sequence, replay.pictures, self._lost)
            )
        began = session.run_dir / "session.json" if context.row["restarts"] else None
        if self._live is not None:
            listeners.append(LiveRow(context, self._live, self._viewer))
        listeners += (
            TapMessages(context.emit, self._viewer, ViewerState(context.row["viewer"])),
            PictureRing(session.segment),
            ShownStamps(partial(context.output, "shown")),
            Trace(self._viewer, began, self._lost),
        )
        for listener in listeners:
            listener.set_options(options)
        return listeners

    def _lost(self, why: str) -> None:
        if self._options.clock.output is not None:  # it needs its trace
            raise UserError(why, "free some space there, or use another --out")
        self._context.report_lost(why)

    def run(self) -> None:
        """Shows pictures until the stop command: one per camera frame, as in the paper, or one per
        refresh of the display.
        """
        if self._refresh is None:
            self._run_on_frames()
        else:
            self._run_on_refreshes(self._refresh)

    def _run_on_frames(self) -> None:
        context = self._context
        while self._wait_for_frame():
            if context.news:
                self._apply_news()
            fresh = self._read_eyes()
            self._read_live()
            if context.paused:
                self._leave_out()
            elif fresh is not None and self._lossless:
                self._show(fresh.t_sensor_ns + int(self._config.replay.latency_ms * MS_NS))
            elif fresh is not None:
                self._show(now_ns() + self._presenter.cost_ns)
            self._after_picture()

    def _run_on_refreshes(self, refresh: Refresh) -> None:
        context = self._context
        refresh.advance(now_ns())  # none was missed while the stage started
        while self._wait_for_refresh(refresh):
            if context.news:
                self._apply_news()
                refresh.limit(self._config.render.rate_hz, self._config.render.nominal_hz)
            if (fresh := self._read_eyes()) is not None:
                if self._record["face"]:
                    self._presenter.changed_ns = now_ns()
                refresh.add_eyes(fresh.source_seq, fresh.t_sensor_ns, now_ns())
            self._read_live()
            if now_ns() >= max(refresh.start_ns(), self._rest_until_ns):
                if context.row["resting"]:
                    refresh.advance(now_ns())  # from refreshes that needed no picture
                if not context.paused:
                    self._show(refresh.due_ns(), refresh.period_ns)
                count = refresh.advance(now_ns())
                self._status.missed(0 if context.row["resting"] else count)
            self._after_picture()

    def _wait_for_frame(self) -> bool:
        """Waits for the next frame, and often enough for the window. Returns False at the stop."""
        fds = self._display.fds if self._context.idle else None
        until_ns = now_ns() + BEAT_NS if self._interactive and fds is None else None
        return self._context.wait(until_ns, fds=fds or ())

    def _wait_for_refresh(self, refresh: Refresh) -> bool:
        """Waits for the next refresh; while nothing changes, for an event or news. Returns False at
        the stop.
        """
        fds = self._display.fds
        can_rest = fds is not None and not (
            self._live is not None or self._field.frame_rate_hz or self._options.trace
        )
        rests = can_rest and now_ns() - self._presenter.changed_ns > REST_AFTER_NS
        self._context.row["resting"] = rests
        if not rests or fds is None:
            self._rest_until_ns = 0
            return self._context.wait(refresh.start_ns())
        if now_ns() >= self._rest_until_ns:
            self._rest_until_ns = now_ns() + REST_NS
        goes_on = self._context.wait(self._rest_until_ns, fds=fds)
        if readable(fds, 0.0):
            self._presenter.changed_ns = now_ns()
        if now_ns() - self._presenter.changed_ns < REST_AFTER_NS:
            self._rest_until_ns = 0
        return goes_on

    def _read_eyes(self) -> Stamp | None:
        """Reads the newest record of the eyes if there is one; returns its stamp."""
        stamp = self._eyes_ring.take(self._record)
        if stamp is None or isinstance(
            self._options.viewer, MouseViewer
        ):  # then the mouse wrote it, in this process
            return None
        self._leave_out()
        self._is_pending = True
        self._eyes.update(EyesRecord.of(self._record), stamp, now_ns())
        return stamp

    def _leave_out(self) -> None:
        """Counts the previous record as left out if no picture was made for it, because of a newer
        one or a pause.
        """
        self._context.row["left_out"] += self._is_pending
        self._is_pending = False

    def _read_live(self) -> None:
        """Reads the newest frame of a live scene."""
        if self._live is None:
            return
        last = self._viewer.last_viewpoints
        middle = (self._field.rows - 1) / 2, (self._field.cols - 1) / 2
        field = self._live.read((middle,) if last is None else last[1:3], now_ns())
        if field is not None:
            self._field = field
            self._viewer.replace(field)
            self._presenter.redraw()

    def _show(self, target_ns: int, refresh_ns: int = 0) -> None:
        on_vblanks = isinstance(self._refresh, ScreenRefresh)
        self._is_pending = False
        self._presenter.show(
            DisplayTime(target_ns, refresh_ns, self._device_latency_ns, on_vblanks)
        )
        self._context.done()  # if this process dies, its successor counts later records as lost

    def _apply_news(self) -> None:
        """Applies changes of configuration, scene and quality, and commands."""
        context = self._context
        requested, options = self._requested_config, self._options
        drawn = self._config, self._share
        self._apply_settings()
        if (self._options.pack, self._options.complete, self._requested_config) != (
            options.pack,
            options.complete,
            requested,
        ):
            with context.setting_up("opening the scene"):
                self._open_scene(options, requested)
            self._presenter.redraw()
        elif (self._config, self._share) != drawn:
            self._viewer.set_quality(self._config, self._share)
            self._presenter.redraw()
        viewer = self._options.viewer
        if viewer.source != options.viewer.source:  # the eyes come from another
            self._eyes.newest = None
            if self._mouse.ring is not None:
                self._mouse.ring.close()
            self._mouse.exchange(isinstance(viewer, MouseViewer))
            self._follow_mouse()
            self._viewer.exchange(isinstance(viewer, MouseViewer | RecordedEyes))
            self._presenter.redraw()
        for listener in self._listeners:
            listener.set_options(self._options)
        context.ack_config()
        for word, message in context.commands():
            match word:
                case "recentre":
                    if not self._mouse.recentre():
                        self._viewer.recentre()
                    self._presenter.redraw()
                    context.answer(message)
                case "look":
                    self._mouse.move(Pointer(x=message["x"], y=message["y"]), now_ns())
                    self._presenter.redraw()
                    context.answer(message)
                case "action":
                    context.answer(
                        message, text=self._ui.act(message["name"], message.get("value", 0.0))
                    )
                case "record" if self._mouse.recorder is not None:
                    self._mouse.recorder.handle(message)
                case "trace":
                    context.answer(message, self._trace_error(message))
                case "loading":
                    self._ui.scenes.report(message)
        for answer in context.answers():
            self._ui.handle(answer)

    def _trace_error(self, message: Message) -> UserError | None:
        """Why a trace, which an option then begins, cannot be written."""
        try:
            with self._context.busy_with("opening a trace"):
                check_output(Path(message["path"]), [Path(path) for path in message["inputs"]])
        except UserError as error:
            return error
        return None

    def _follow_mouse(self) -> None:
        """Records the mouse where it is the viewer; capture records cameras."""
        if isinstance(self._options.viewer, MouseViewer) and self._mouse.recorder is None:
            self._mouse.recorder = Recorder(self._context, self._context.config.camera.frame_px)

    def _open_scene(self, before: SessionOptions, requested: Config) -> None:
        """Shows the scene of the current settings. before, requested: those until now."""
        options = self._options
        invert_depth = self._requested_config.scene.invert_depth
        is_packed_anew = (options.pack, options.complete) != (before.pack, before.complete)
        if is_packed_anew:
            self._live = None
            self._field = open_pack(Path(options.pack), invert_depth)
            logger.info("scene %s%s", options.pack, "" if options.complete else ", views only")
        elif invert_depth != requested.scene.invert_depth and self._live is None:
            # the depth of a live scene is turned where it is read
            self._field = shown_as(self._field, invert_depth)
        self._store_choice()
        only_disparity_is_new = options.pack == before.pack and self._requested_config == requested
        self._viewer.set(self._field, self._config, self._share, only_disparity_is_new)
        if is_packed_anew:
            self._measure_costs()

    def _store_choice(self) -> None:
        """Stores the depth order that the user chose, of a scene that is not live; a replay only
        applies it.
        """
        word = self._context.config.scene.invert_depth
        if word != "auto" and not self._lossless and self._live is None:
            self._files.do(partial(remember, self._field, word))

    def _after_picture(self) -> None:
        """Handles keys and notices, which do not change the current picture; without a window, ten
        times a second.
        """
        if self._context.paused:
            # without tracking, no face is missing
            self._context.row["t_face_ns"] = now_ns()
        if self._interactive or now_ns() >= self._serve_ns:
            self._serve_ns = now_ns() + BEAT_NS
            self._ui.serve()
        self._presenter.report()
        self._report_costs()
        self._report_gpu()
        waits = self._mouse.ring is None and isinstance(self._options.viewer, MouseViewer)
        if waits and self._context.table.rows[TRACK]["state"] in ENDED:  # a ring has one writer
            self._mouse.ring = self._context.output("eyes")
        if self._mouse.recorder is not None:
            self._mouse.recorder.report()

    def close(self) -> None:
        """Writes pending outputs and closes the display."""
        still = self._options.still
        picture = self._presenter.saved_picture() if still else None
        if picture is not None and (failure := save(Path(still), picture)):
            self._context.report_lost(failure)
        self._presenter.close()
        try:
            with blaming(IN_USE):
                self._display.close()
        except UserError as error:  # its file may be incomplete, and nobody waits for the stage
            self._context.report_lost(error.message)
        self._ui.pass_on_notices()
        self._files.close()
        if self._mouse.recorder is not None:
            self._mouse.recorder.close()


def main(context: Context) -> None:
    """Runs the stage until the stop command."""
    stage = RenderStage(context)
    context.ready()
    try:
        stage.run()
    finally:
        stage.close()
