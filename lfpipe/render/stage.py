"""Render: one picture for each refresh of the display, or for each camera frame.

Reads: ring "eyes", the newest record; the packed scene named by option "pack".
Writes: the display of option "display"; the trace of option "trace"; the last picture to option "still".
Commands: recentre, loading (progress), stop; settings and another scene by configuration, a lowered quality by option "level".
Asks: set, recentre, load, pause, resume, stop (keys of the window).
Emits: parallax (alpha and its reasons), viewer (nobody, arriving, seated, lost, exchanged), notice (an output was lost).
"""

from pathlib import Path

from lfpipe.config import Config
from lfpipe.config.quality import lowered
from lfpipe.render.display import Display, open_display
from lfpipe.render.file_display import save
from lfpipe.render.key_bindings import KeyBindings
from lfpipe.render.presenter import Presenter
from lfpipe.render.refresh import Refresh, ScreenClock, ScreenRefresh
from lfpipe.render.viewer import Viewer
from lfpipe.scene.half_turn import remember, shown_as
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import open_pack
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.context import Context

MARGIN_NS = MS_NS  # additional lead of composing


def new_refresh(config: Config, display: Display, presenter: Presenter) -> Refresh | ScreenRefresh:
    """The display's clock: the screen's blanks if they are reported, else an even rate."""
    if not display.blanks_by:
        return Refresh(config.render.nominal_hz, now_ns())
    presenter.clock = presenter.clock or ScreenClock(display.nominal_hz(), now_ns())
    limit_hz = 0.0 if config.render.rate_hz == "auto" else config.render.nominal_hz
    return ScreenRefresh(presenter.clock, presenter.lead, limit_hz, now_ns())


def lead_ns(refresh: Refresh | ScreenRefresh, presenter: Presenter) -> int:
    """The time before its due time at which a picture must be begun."""
    return presenter.cost_ns + MARGIN_NS if isinstance(refresh, Refresh) else refresh.lead_ns()


def keep_choice(context: Context, field: LightField) -> None:
    """Remembers near and far as a person chose them; a replay only applies what was chosen."""
    if (word := context.config.scene.half_turn) != "auto" and not context.options.lossless:
        remember(field, word)


def main(context: Context) -> None:
    """Runs the stage until the stop command."""
    asked, options = context.config, context.options
    config = lowered(asked, options)
    with context.setting_up("opening the scene"):
        field = open_pack(Path(options.pack), config.scene.half_turn)
        viewer = Viewer(field, config, bool(options.kiosk))
    keep_choice(context, field)
    lossless = options.lossless  # then pictures depend on the frames alone, not on a clock
    on_camera = (lossless or config.render.clock == "camera") and options.tracking
    full_hz = float(options.source_hz) if on_camera else asked.render.nominal_hz
    size_px, monitor = (field.width_px, field.height_px), str(config.screen.monitor)
    part = context.row["restarts"]
    display = open_display(options.display, size_px, f"lfpipe: {field.name}", full_hz, monitor, part, options.kiosk)
    viewer.shown_as_wide(display.width_mm())
    presenter = Presenter(context, viewer, display)
    keys = KeyBindings(context, viewer, presenter, display)
    if options.start and not part:
        keys.menu.open()
    refresh = None if on_camera else new_refresh(config, display, presenter)
    middle = ((field.rows - 1) / 2, (field.cols - 1) / 2)
    viewer.compositor.compose(middle, middle)  # builds tables and touches pages before the first picture is due
    context.row["t_face_ns"] = now_ns()
    context.ready()
    try:
        while context.wait(None if refresh is None else refresh.due_ns() - lead_ns(refresh, presenter)):
            if (context.options.pack, context.options.complete) != (options.pack, options.complete) or context.config != asked:
                with context.setting_up("opening the scene"):
                    if (context.options.pack, context.options.complete) != (options.pack, options.complete):
                        field = open_pack(Path(context.options.pack), context.config.scene.half_turn)
                    elif context.config.scene.half_turn != asked.scene.half_turn:
                        field = shown_as(field, context.config.scene.half_turn)
                    keep_choice(context, field)
                    completed = context.options.pack == options.pack and context.config == asked
                    asked, options = context.config, context.options
                    config = lowered(asked, options)
                    (viewer.complete if completed else viewer.set)(field, config)
                presenter.redraw()
            elif (now := lowered(asked, context.options)) != config:
                if refresh is not None and now.render.rate_hz != config.render.rate_hz:
                    refresh = new_refresh(now, display, presenter)
                config = now
                viewer.redraw_by(config)
                presenter.redraw()
            presenter.follow(context.options)
            context.ack_config()
            for word, message in context.commands():
                if word == "recentre":
                    viewer.recentre()
                    presenter.redraw()
                elif word == "loading":
                    keys.scenes.report(message)
                elif not word:
                    keys.scenes.answered(message)
            fresh = presenter.take()
            if fresh is not None and isinstance(refresh, Refresh):
                refresh.heard(fresh.source_seq, fresh.t_sensor_ns, now_ns(), lead_ns(refresh, presenter))
            if refresh is None:
                if context.paused:
                    presenter.leave_out()
                elif fresh is not None:
                    latency_ns = int(config.replay.latency_ms * MS_NS)
                    presenter.show(fresh.t_sensor_ns + latency_ns if lossless else now_ns() + presenter.cost_ns)
            elif now_ns() >= refresh.due_ns() - lead_ns(refresh, presenter):
                if not context.paused:
                    presenter.show(refresh.due_ns(), refresh.period_ns)
                before = refresh.missed
                refresh.advance(now_ns())
                presenter.missed(refresh.missed - before)
            keys.serve()  # after the picture: keys can wait for the next one
            presenter.follow_screen()
    finally:
        if options.still and presenter.picture is not None:
            if failure := save(Path(options.still), presenter.picture):
                context.report_lost(failure)
            else:
                context.emit("notice", text=f"picture saved as {options.still}")
        presenter.close()
        display.close()
        keys.pass_on_notices()
