"""`lfpipe monitor` as text: the state of a session for people (also for `ctl status` and the end of
`lfpipe up`), and the terminal screen with keys.
"""

import json
import os
import sys
import textwrap
import time
from contextlib import closing
from datetime import timedelta
from functools import partial

from rich.console import Console
from rich.text import Text

from lfpipe.config import choices
from lfpipe.errors import UserError, plain
from lfpipe.host.terminal import Keyboard
from lfpipe.monitor.session_reader import Follower, Sample, Watch, snapshot
from lfpipe.monitor.timeline import begin_trace, finish_trace
from lfpipe.notices import latency_lines
from lfpipe.supervisor.metrics import MotionToPhoton, SessionMetrics, StageMetrics
from lfpipe.supervisor.process_table import SOURCE
from lfpipe.supervisor.rundir import ask, find
from lfpipe.transport.control import Message
from lfpipe.transport.histogram import quantiles
from lfpipe.transport.metrics import Value

STATE_STYLE = {"RUNNING": "green", "STARTING": "yellow", "STOPPING": "yellow", "DEAD": "bold red"}
WARNING = "bold yellow"
KEYS_LINE = "q quit  p pause  r reset  t trace  w warp  m mode  c recentre"
QUANTILES = ("p50_ms", "p95_ms", "p99_ms")
PERIOD_S = 0.25  # four times a second: people cannot read faster
BAR_TEXT = 18  # cells before a bar
NOTE_S = 5.0  # display time of the answer to a key


def ms(value: float) -> str:
    """A time in ms in five characters, with as many decimals as fit."""
    if value < 99.995:
        return f"{value:5.2f}"
    return f"{value:5.1f}" if value < 999.95 else f"{value:5.0f}"


def photon_words(latency: MotionToPhoton) -> str:
    """The known latencies as text, for example `onset 61.2 ms, steady 4.0 ms`."""
    times = {"onset": latency.onset_ms, "steady": latency.steady_ms}
    return ", ".join(f"{key} {value:.1f} ms" for key, value in times.items() if value is not None)


def _stage_line(name: str, stage: StageMetrics, loads: bool) -> Text:
    """A stage in the table; loads: include its load."""
    waits, busies = ([times[key] for key in QUANTILES] for times in (stage.wait, stage.busy))
    times = "".join(f" {ms(value)}" for value in (*waits[:2], *busies, stage.max_ms))
    return Text.assemble(
        f"{name:<8}",
        (f"{stage.state.lower():<9}", STATE_STYLE.get(stage.state, "")),
        f"{stage.fps:5.1f}{times}",
        (f" {stage.dropped:5d}", "bold red" if stage.dropped else ""),
        (f" {stage.restarts:3d}", "bold red" if stage.restarts else ""),
        f" {stage.cpu_percent or 0:4.0f}{stage.rss_mb or 0:4.0f}\n" if loads else "\n",
        (plain(f"{'':<8}{stage.busy_with}\n") if stage.busy_with else "", "yellow"),
    )


def state_text(metrics: SessionMetrics, paused: bool = False) -> Text:
    """The table of stages (rate, wait, busy, drops, restarts, load if it is known), quality, and
    the age of the picture. At most 80 cells wide.
    """
    tracked = metrics.stages.get("track")
    has_face = tracked is not None and tracked.face
    stages = metrics.used_stages
    loads = any(stage.cpu_percent is not None for stage in stages.values())
    level = f"level {metrics.level} of {metrics.lowest_level}" if metrics.level else "full"
    camera = f"camera {metrics.camera_fps:.1f} Hz" if SOURCE in stages else "no camera"
    age, judder = metrics.end_to_end, metrics.judder
    parts: list[Text | str | tuple[str, str]] = [
        f"up {timedelta(seconds=int(metrics.uptime_s))}  {camera}  ",
        ("PAUSED  " if paused else "", WARNING),
        (f"{metrics.camera_light}  " if metrics.camera_light else "", WARNING),
        (f"viewer {metrics.viewer}\n", "green" if has_face else WARNING),
        (f"{'':<22} wait, ms     busy, ms\n", "bold"),
        (f"{'stage':<8}{'state':<9}{'Hz':>5}   p50   p95   p50   p95   p99   max drops", "bold"),
        (f" rst{'   %  MB' * loads}\n", "bold"),
        *(_stage_line(name, stage, loads) for name, stage in stages.items()),
        (f"quality {level}\n", WARNING if metrics.level else "dim"),
        *((plain(f"now: {notice}\n"), WARNING) for notice in metrics.notices),
    ]
    lines = latency_lines(age, metrics.prediction, bool(judder.planned))
    if age["n"]:
        counted = f"  over {age['n']:.0f} pictures; the delays of camera and display are not in it"
        lines.insert(1, counted)
    parts += [f"{line}\n" for line in lines]
    if judder.planned:
        parts.append(
            f"judder: {judder.percent:.2f} % of {judder.planned} refreshes showed another"
            " picture than planned\n"
        )
    if words := photon_words(metrics.motion_to_photon):
        parts.append(f"motion to photon: {words}\n")
    return Text.assemble(*parts, no_wrap=True, overflow="crop")


def bars(metrics: SessionMetrics, width: int) -> list[Text]:
    """How long each stage lets a frame wait and works on it, p95: the longest bar is where time
    goes.
    """
    stages = metrics.used_stages
    times = {
        name: (stage.wait["p95_ms"], stage.busy["p95_ms"])
        for name, stage in stages.items()
        if stage.busy["n"]
    }
    longest = max((sum(pair) for pair in times.values()), default=0.0)
    if not longest:
        return []
    cells = (width - BAR_TEXT) / longest
    return [
        Text(f"{'p95 of':<8}waiting ░ and work █", "bold"),
        *(
            Text.assemble(
                f"{name:<8}{ms(wait + busy)} ms ",
                ("░" * round(wait * cells), "dim"),
                ("█" * max(1, round(busy * cells)), "cyan"),
            )
            for name, (wait, busy) in times.items()
        ),
    ]


def filled(text: Text, metrics: SessionMetrics, width: int, height: int) -> Text:
    """text with as many of the bars and of the stages' own metrics below as a terminal of that size
    has room for.
    """
    lines = list(text.split("\n"))
    for more in (bars(metrics, width), [Text(plain(line)) for line in metric_lines(metrics)]):
        if more and len(lines) + 1 + len(more) <= height:
            lines += [Text(""), *more]
    return Text("\n", no_wrap=True, overflow="crop").join(lines)


def metric_lines(metrics: SessionMetrics) -> list[str]:
    """The metrics that each stage declares, without time stamps. At most 80 cells wide."""
    lines = []
    for name, stage in metrics.used_stages.items():
        values = {key: value for key, value in stage.metrics.items() if not key.endswith("_ns")}
        text = ", ".join(f"{key} {_shown(value)}" for key, value in values.items())
        lines += textwrap.wrap(f"{name:<8}{text}", 80, subsequent_indent=" " * 8) if text else []
    return lines


def _shown(value: Value) -> str:
    """A value in a few characters."""
    if isinstance(value, dict):
        return quantiles(value, "p50_ms", "p95_ms")
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "-" if value is None else str(value)


def print_state(metrics: SessionMetrics, paused: bool = False) -> None:
    """Prints the state on stdout."""
    head = Text.assemble("session ", (metrics.session, "bold"), "  ")
    out = head.append_text(state_text(metrics, paused))
    out.append("".join(f"{plain(line)}\n" for line in metric_lines(metrics)))
    Console(highlight=False, soft_wrap=True).print(out, end="")


def screen_text(name: str, state: Sample | None, note: str = "") -> Text:
    """The whole screen of a monitor.

    note: the answer to the last key.
    """
    out = Text.assemble(
        ("lfpipe ", "bold"), (name, "bold cyan"), "  ", no_wrap=True, overflow="crop"
    )
    if state is None:
        return out.append("no session; waiting for one (q quits)\n")
    settings = state.settings
    if settings is not None:
        render = settings.config.render
        timeline = settings.options.timeline
        alpha = render.alpha_px if isinstance(render.alpha_px, str) else f"{render.alpha_px:.1f}"
        out.append(f"{render.method} views, {render.anaglyph} anaglyph, alpha {alpha}", "dim")
        out.append(plain(f"\ntracing to {timeline}") if timeline else "", "dim")
    paused = settings is not None and settings.paused
    out.append("\n").append_text(state_text(state.metrics, paused))
    out.append(plain(f"{note or KEYS_LINE}\n"), "bold" if note else "dim")
    return out.append("times of the last 10 s; rst: restarts", "dim")


def fitted(text: Text, width: int, height: int) -> Text:
    """The part of text that fits a terminal of that size; if cut, the last line states the number
    of omitted items.
    """
    lines = text.split("\n")
    columns = max(line.cell_len for line in lines) - width
    if columns <= 0 and len(lines) <= height:
        return text
    kept = lines[: height - 1]
    more = {"columns": columns, "lines": len(lines) - len(kept)}
    missing = ", ".join(f"{count} {what}" for what, count in more.items() if count > 0)
    return Text("\n", no_wrap=True, overflow="crop").join(
        [*kept, Text(f"left out: {missing}", "bold yellow")]
    )


def press(name: str, key: str) -> str:
    """Runs the command bound to a key; returns a status line, "" for an unknown key.

    Raises UserError.
    """
    if key not in ("p", "w", "m", "c", "t"):
        return ""
    settings = snapshot(name)
    render = settings.config.render
    if key == "t" and settings.options.timeline:
        return f"trace: {finish_trace(partial(ask, name))}"
    if key == "t":
        begin_trace(partial(ask, name), None)
        return "tracing: t ends it"
    method = "auto" if render.method == "nearest" else "nearest"
    modes = choices("render.anaglyph")
    mode = modes[(modes.index(render.anaglyph) + 1) % len(modes)]
    sent: dict[str, tuple[Message, str]] = {
        "p": (
            {"cmd": "resume" if settings.paused else "pause"},
            "resumed" if settings.paused else "paused: p resumes",
        ),
        "w": ({"cmd": "set", "set": {"render.method": method}}, f"views: {method}"),
        "m": ({"cmd": "set", "set": {"render.anaglyph": mode}}, f"mode: {mode}"),
        "c": ({"cmd": "recentre"}, "recentred"),
    }
    message, note = sent[key]
    ask(name, message)
    return note


def run(name: str, once: bool, as_json: bool) -> None:
    """Shows the session of that name: one state, JSON lines until it ends, or the screen in a
    terminal. Raises UserError if it is not running.
    """
    redraws = sys.stdout.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown")
    with closing(Watch(find(name))) as watch:
        if not as_json and (once or not redraws):
            print_state(watch.read())
        while as_json:
            print(json.dumps(watch.read().to_dict()), flush=True)
            if once or not watch.living():
                return
            time.sleep(PERIOD_S)
    if redraws and not once:
        screen(name)


def screen(name: str) -> None:
    """The terminal screen, until q or Ctrl-C.

    If the session ends, it waits for the next one of that name.
    """
    from rich.live import Live

    note = ""
    note_end = 0.0
    with (
        closing(Follower(name)) as follower,
        Keyboard() as keyboard,
        Live(screen=True, auto_refresh=False) as live,
    ):
        while True:
            now = time.monotonic()
            sample = follower.read()
            text = screen_text(name, sample, note if now < note_end else "")
            size = live.console.size
            if sample is not None:
                text = filled(text, sample.metrics, *size)
            live.update(fitted(text, *size), refresh=True)
            while left_s := max(0.0, now + PERIOD_S - time.monotonic()):
                try:
                    key = keyboard.key(left_s)
                    if key == "r":
                        follower.reset()
                        note = "counts reset"
                    elif key:
                        note = press(name, key)
                except KeyboardInterrupt:
                    key = "q"
                except UserError as error:
                    note = f"{error.message} ({error.remedy})"
                if key == "q":
                    return
                if key:
                    note_end = time.monotonic() + NOTE_S
