"""Render: one picture for each refresh of the display, or for each camera frame.

Reads: ring "eyes", the newest record; the packed scene named by option "pack".
Writes: the display of option "display"; the trace of option "trace"; the last picture to option "still"; without a camera, ring
"eyes" from the mouse.
Commands: recentre, loading (progress), stop; settings and another scene by configuration, a lowered quality by option "level".
Asks: set, recentre, load, pause, resume, record, stop (keys and bar of the window).
Emits: parallax (alpha and its reasons), viewer (nobody, arriving, seated, lost, exchanged), notice (an output was lost).
"""

import gc
import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from lfpipe.config import Config
from lfpipe.config.quality import lowered
from lfpipe.host.processes import run_on
from lfpipe.render.display import open_display
from lfpipe.render.file_display import save
from lfpipe.render.key_bindings import KeyBindings
from lfpipe.render.presenter import Presenter
from lfpipe.render.refresh import Refresh, ScreenRefresh
from lfpipe.render.viewer import Viewer
from lfpipe.scene.half_turn import remember, shown_as
from lfpipe.scene.pack import open_pack
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.context import Context

logger = logging.getLogger(__name__)
SERVE_NS = 100 * MS_NS  # between two looks at keys and notices without a window: nobody presses one


class RenderStage:
    """The scene, its viewer and its display, under the configuration in force."""

    def __init__(self, context: Context) -> None:
        self._context, self._asked, self._options = context, context.config, context.options
        self._config = lowered(self._asked, self._options)
        options = self._options
        with context.setting_up("opening the scene"):
            self._field = open_pack(Path(options.pack), self._config.scene.half_turn)
            helper = (
                ThreadPoolExecutor(1, "half", run_on, (context.cores,))
                if len(context.cores) > 1
                else None
            )  # on any of them
            self._viewer = Viewer(self._field, self._config, bool(options.kiosk), helper)
        self._keep_choice()
        # without a clock, pictures depend on the frames alone
        self.on_camera = (
            options.lossless or self._config.render.clock == "camera"
        ) and options.tracking
        rate_hz = float(options.source_hz) if self.on_camera else self._asked.render.nominal_hz
        size_px, monitor = (
            (self._field.width_px, self._field.height_px),
            str(self._config.screen.monitor),
        )
        restarts = context.row["restarts"]
        name = f"lfpipe: {self._field.name}"
        self._display = open_display(
            options.display, size_px, name, rate_hz, monitor, restarts, options.kiosk
        )
        self._interactive, self._serve_ns = (
            options.display != "none" and not options.display.startswith("file:"),
            0,
        )
        self._viewer.shown_as_wide(self._display.width_mm())
        self._presenter = Presenter(context, self._viewer, self._display)
        self._keys = KeyBindings(context, self._viewer, self._presenter, self._display)
        middle = ((self._field.rows - 1) / 2, (self._field.cols - 1) / 2)
        self._viewer.compositor.compose(
            middle, middle
        )  # builds tables and touches pages before the first picture is due
        context.row["t_face_ns"] = now_ns()

    def on_frames(self) -> None:
        """One picture per camera frame, as in the paper, until the stop."""
        presenter, context, lossless = self._presenter, self._context, self._options.lossless
        while context.wait():
            if context.news:
                self._follow_session()
            fresh = presenter.take()
            if context.paused:
                presenter.leave_out()
            elif fresh is not None:
                latency_ns = int(self._config.replay.latency_ms * MS_NS)
                presenter.show(
                    fresh.t_sensor_ns + latency_ns if lossless else now_ns() + presenter.cost_ns
                )
            self._after_picture()

    def on_refreshes(self) -> None:
        """One picture per refresh of the display, until the stop."""
        presenter, context = self._presenter, self._context
        screen = (
            self._display.blanks_by
        )  # the screen's blanks if they are reported, else an even rate
        refresh = (
            ScreenRefresh(self._display.nominal_hz(), now_ns())
            if screen
            else Refresh(self._config.render.nominal_hz, now_ns())
        )
        presenter.refresh = refresh
        while context.wait(refresh.start_ns()):
            if context.news:
                self._follow_session()
                refresh.limit(self._config.render.rate_hz, self._config.render.nominal_hz)
            if (fresh := presenter.take()) is not None:
                refresh.heard(fresh.source_seq, fresh.t_sensor_ns, now_ns())
            if now_ns() >= refresh.start_ns():
                if not context.paused:
                    presenter.show(refresh.due_ns(), refresh.period_ns)
                if count := refresh.advance(now_ns()):
                    presenter.missed(count)
            self._after_picture()

    def _follow_session(self) -> None:
        """Applies changes of configuration, scene and quality, and commands."""
        context, viewer, presenter = self._context, self._viewer, self._presenter
        old, new = self._options, context.options
        other_pack = (new.pack, new.complete) != (old.pack, old.complete)
        if other_pack or context.config != self._asked:
            with context.setting_up("opening the scene"):
                self._open_scene(other_pack)
            presenter.redraw()
        elif new is not old:
            self._options = new
            config: Config = lowered(self._asked, new)
            if config != self._config:
                self._config = config
                logger.info("quality: %s at %s Hz", config.render.method, config.render.rate_hz)
                viewer.redraw_by(config)
                presenter.redraw()
        presenter.follow()
        context.ack_config()
        for word, message in context.commands():
            if word == "recentre":
                if not presenter.mouse.recentre():
                    viewer.recentre()
                presenter.redraw()
            elif word == "loading":
                self._keys.scenes.report(message)
            elif not word:
                self._keys.scenes.answered(message)

    def _open_scene(self, other_pack: bool) -> None:
        """Takes over configuration and options, with their scene. other_pack: it was packed anew, or further."""
        context, half_turn = self._context, self._context.config.scene.half_turn
        completed = context.options.pack == self._options.pack and context.config == self._asked
        if other_pack:
            self._field = open_pack(Path(context.options.pack), half_turn)
            logger.info(
                "scene %s%s",
                context.options.pack,
                "" if context.options.complete else ", views only",
            )
        elif half_turn != self._asked.scene.half_turn:
            self._field = shown_as(self._field, half_turn)
        self._keep_choice()
        self._asked, self._options = context.config, context.options
        self._config = lowered(self._asked, self._options)
        (self._viewer.complete if completed else self._viewer.set)(self._field, self._config)
        if other_pack:
            gc.unfreeze()  # the old compositor's parts refer to one another, and to the maps of the pack
            gc.collect()
            gc.freeze()

    def _keep_choice(self) -> None:
        """Remembers near and far as a person chose them; a replay only applies what was chosen."""
        if (
            word := self._context.config.scene.half_turn
        ) != "auto" and not self._context.options.lossless:
            remember(self._field, word)

    def _after_picture(self) -> None:
        """What does not change the picture just shown: keys and notices, without a window ten times a second."""
        if self._context.paused:
            self._context.row["t_face_ns"] = (
                now_ns()
            )  # while nobody looks for a face, none is missed
        if self._interactive or now_ns() >= self._serve_ns:
            self._serve_ns = now_ns() + SERVE_NS
            self._keys.serve()
        if self._display.blanks_by:
            self._presenter.follow_screen()

    def close(self) -> None:
        """Writes what is left to write."""
        still, picture = self._options.still, self._presenter.picture
        if still and picture is not None and (failure := save(Path(still), picture)):
            self._context.report_lost(failure)
        self._presenter.close()
        self._display.close()
        self._keys.pass_on_notices()


def main(context: Context) -> None:
    """Runs the stage until the stop command."""
    stage = RenderStage(context)
    context.ready()
    try:
        if stage.on_camera:
            stage.on_frames()
        else:
            stage.on_refreshes()
    finally:
        stage.close()
