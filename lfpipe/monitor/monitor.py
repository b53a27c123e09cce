"""`lfpipe monitor` as text: the state of a session for people (also for `ctl status` and the end of
`lfpipe up`), and the terminal screen with keys; and the trace as Chrome trace-event JSON for
Perfetto and chrome://tracing: one track per stage.

Slices: capture from the sensor's stamp to the decoded frame, track from there to its eyes, render
while a picture is composed, display until it is presented. Format: "Trace Event Format" (Google,
2016) with complete events X and metadata M.
"""

import json
import os
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from lfpipe import log
from lfpipe.errors import UserError, plain
from lfpipe.files.safe_files import PLACE, check_output, reason, replaced, trace_lines
from lfpipe.host.terminal import keyboard
from lfpipe.monitor.session_reader import Follower, Sample, Watch, snapshot
from lfpipe.notices import latency_lines
from lfpipe.supervisor.metrics import MotionToPhoton, SessionMetrics, StageMetrics
from lfpipe.supervisor.process_table import CORE, SOURCE
from lfpipe.supervisor.rundir import ask, find
from lfpipe.transport.control import FILE_CHECK_TIMEOUT_S
from lfpipe.transport.status import Value, quantiles

TRACKS = (*CORE, "display")
PID = 1


def events(trace: Iterable[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Trace events of a trace's objects. Times in microseconds of CLOCK_MONOTONIC."""
    yield {"name": "process_name", "ph": "M", "pid": PID, "tid": 0, "args": {"name": "lfpipe"}}
    for tid, name in enumerate(TRACKS, 1):
        yield {"name": "thread_name", "ph": "M", "pid": PID, "tid": tid, "args": {"name": name}}
        yield {
            "name": "thread_sort_index",
            "ph": "M",
            "pid": PID,
            "tid": tid,
            "args": {"sort_index": tid},
        }
    end_ns = dict.fromkeys(TRACKS, 0)

    def slice_of(name: str, start: int, end: int, **about: Any) -> dict[str, Any]:
        """A slice, shortened so that slices of a track do not overlap: viewers would nest them."""
        start = max(start, end_ns[name])
        end_ns[name] = end = max(end, start)
        return {
            "name": name,
            "cat": "stage",
            "ph": "X",
            "pid": PID,
            "tid": TRACKS.index(name) + 1,
            "ts": start / 1e3,
            "dur": (end - start) / 1e3,
            "args": {"source_seq": line["source_seq"], "epoch": line["epoch"], **about},
        }

    before = None
    for line in trace:
        if (line["epoch"], line["source_seq"]) != before:
            before = line["epoch"], line["source_seq"]
            yield slice_of("capture", line["t_sensor_ns"], line["t_read_ns"])
            yield slice_of("track", line["t_read_ns"], line["t_tracked_ns"], face=line["face"])
        if line["composed"]:
            started_ns = line.get("t_started_ns", line["t_tracked_ns"])
            composed_ns = line["t_composed_ns"]
            presented_ns = line["t_presented_ns"] or composed_ns  # 0: replaced before it was seen
            yield slice_of(
                "render", started_ns, composed_ns, method=line["method"], view=line["view"]
            )
            age_ms = (presented_ns - line["t_sensor_ns"]) / 1e6
            yield slice_of("display", composed_ns, presented_ns, age_ms=age_ms)


def convert(source: Path, out: Path, overwrite: bool = False) -> None:
    """Writes the JSON Lines trace `source` as trace events to `out`, readable by its owner only.
    Raises UserError and leaves out unchanged.
    """
    check_output(out, [source], overwrite)
    remedy = "name a trace of `lfpipe up --trace` or `lfpipe trace start`"
    lines = (fields.values for fields in trace_lines(source, remedy))
    try:
        with replaced(out) as file:
            for number, event in enumerate(events(lines)):
                start = b",\n" if number else b'{"displayTimeUnit": "ms", "traceEvents": [\n'
                file.write(start + json.dumps(event).encode())
            file.write(b"\n]}\n")
    except OSError as error:
        raise UserError(f"{out}: {reason(error)}", PLACE) from None


def begin_trace(name: str, out: Path | None) -> Path:
    """Starts a trace of the session of that name, in a new file in this folder if out is None.

    Returns its path. Raises UserError.
    """
    out = (out or Path(time.strftime("lfpipe-%Y%m%d-%H%M%S.jsonl"))).absolute()
    ask(name, {"cmd": "trace", "path": str(out)}, FILE_CHECK_TIMEOUT_S)
    return out


def finish_trace(name: str) -> Path:
    """Ends the trace that `begin_trace` started. Returns its path. Raises UserError if none
    runs.
    """
    return Path(ask(name, {"cmd": "trace", "path": ""})["path"])


STATE_STYLE = {"RUNNING": "green", "STARTING": "yellow", "STOPPING": "yellow", "DEAD": "bold red"}
WARNING = "bold yellow"
KEYS_LINE = "q quit  p pause  r reset  t trace  c recentre"
QUANTILES = ("p50_ms", "p95_ms", "p99_ms")
PERIOD_S = 0.25  # four times a second: people cannot read faster
COLUMNS = (
    "stage",
    "state",
    "Hz",
    "wait\np50",
    "\np95",
    "busy\np50",
    "\np95",
    "\np99",
    "\nmax",
    "drops",
    "rst",
)
LOADS = ("%", "MB")
SPARKS = "▁▂▃▄▅▆▇█"
HISTORY = 60  # ages of pictures, one of each second
NOTE_S = 5.0  # display time of the answer to a key


def photon_words(latency: MotionToPhoton) -> str:
    """The known latencies as text, for example `onset 61.2 ms, steady 4.0 ms`."""
    times = {"onset": latency.onset_ms, "steady": latency.steady_ms}
    return ", ".join(f"{key} {value:.1f} ms" for key, value in times.items() if value is not None)


def stage_table(stages: Mapping[str, StageMetrics]) -> Table:
    """Rate, wait, busy, drops, restarts, and load if it is known, of every stage."""
    table = Table(box=None, padding=(0, 1, 0, 0), collapse_padding=True)
    loads = any(stage.cpu_percent is not None for stage in stages.values())
    for title in (*COLUMNS, *(LOADS if loads else ())):
        left = title in COLUMNS[:2]
        table.add_column(title, justify="left" if left else "right", no_wrap=True)
    for name, stage in stages.items():
        waits, busies = ([times[key] for key in QUANTILES] for times in (stage.wait, stage.busy))
        table.add_row(
            name,
            Text(stage.state.lower(), STATE_STYLE.get(stage.state, "")),
            f"{stage.fps:.1f}",
            *map("{:.1f}".format, (*waits[:2], *busies, stage.max_ms)),
            *(
                Text(str(count), "bold red" if count else "")
                for count in (stage.dropped, stage.restarts)
            ),
            *(f"{value:.0f}" for value in (stage.cpu_percent, stage.rss_mb) if value is not None),
        )
    return table


def state_view(metrics: SessionMetrics, paused: bool = False) -> Group:
    """The table of stages, what each one waits for, quality, and the age of the picture."""
    tracked = metrics.stages.get("track")
    has_face = tracked is not None and tracked.face
    stages = metrics.used_stages
    level = f"level {metrics.level} of {metrics.lowest_level}" if metrics.level else "full"
    camera = f"camera {metrics.camera_fps:.1f} Hz" if SOURCE in stages else "no camera"
    age, judder = metrics.end_to_end, metrics.judder
    head = Text.assemble(
        f"up {timedelta(seconds=int(metrics.uptime_s))}  {camera}  ",
        ("PAUSED  " if paused else "", WARNING),
        (f"viewer {metrics.viewer}", "green" if has_face else WARNING),
    )
    busy = [
        Text(plain(f"{name}: {stage.busy_with}"), "yellow")
        for name, stage in stages.items()
        if stage.busy_with
    ]
    notices = [Text(plain(f"now: {notice}"), WARNING) for notice in metrics.notices]
    lines = latency_lines(age, metrics.prediction, bool(judder.planned))
    if age["n"]:
        counted = f"  over {age['n']:.0f} pictures; the delays of camera and display are not in it"
        lines.insert(1, counted)
    if judder.planned:
        lines.append(
            f"judder: {judder.percent:.2f} % of {judder.planned} refreshes showed another"
            " picture than planned"
        )
    if words := photon_words(metrics.motion_to_photon):
        lines.append(f"motion to photon: {words}")
    quality = Text(f"quality {level}", WARNING if metrics.level else "dim")
    return Group(head, stage_table(stages), *busy, quality, *notices, *map(Text, lines))


def metric_lines(metrics: SessionMetrics) -> list[Text]:
    """The metrics that each stage declares, without time stamps."""
    lines = []
    for name, stage in metrics.used_stages.items():
        values = {key: value for key, value in stage.metrics.items() if not key.endswith("_ns")}
        if values:
            words = ", ".join(f"{key} {_shown(value)}" for key, value in values.items())
            lines.append(Text(plain(f"{name} {words}")))
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
    console = Console(highlight=False)
    console.print(Text.assemble("session ", (metrics.session, "bold")), state_view(metrics, paused))
    if log.is_shown():
        console.print(*metric_lines(metrics), sep="\n")


def sparkline(values: Sequence[float]) -> str:
    """Values >= 0 as blocks, the largest one as high as a line."""
    most = max(values, default=0.0) or 1.0
    return "".join(SPARKS[round(value / most * (len(SPARKS) - 1))] for value in values)


def screen_view(
    name: str, state: Sample | None, note: str = "", ages_ms: Sequence[float] = ()
) -> Group:
    """The whole screen of a monitor.

    note: the answer to the last key. ages_ms: of the pictures, one of each second.
    """
    head = Text.assemble(("lfpipe ", "bold"), (name, "bold cyan"), "  ")
    if state is None:
        return Group(head.append("no session; waiting for one (q quits)"))
    settings = state.settings
    if settings is not None:
        render = settings.config.render
        trace = settings.options.trace
        alpha = render.alpha_px if isinstance(render.alpha_px, str) else f"{render.alpha_px:.1f}"
        head.append(f"{render.method} views, {render.anaglyph} anaglyph, alpha {alpha}", "dim")
        head.append(plain(f"\ntracing to {trace}") if trace else "", "dim")
    return Group(
        head,
        state_view(state.metrics, settings is not None and settings.paused),
        *([Text(f"age, {sparkline(ages_ms)} up to {max(ages_ms):.1f} ms")] if any(ages_ms) else ()),
        Text(plain(note or KEYS_LINE), "bold" if note else "dim", no_wrap=True),
        Text("times in ms, of the last 10 s; rst: restarts", "dim"),
        *(metric_lines(state.metrics) if log.is_shown() else ()),
    )


def press(name: str, key: str) -> str:
    """Runs the command bound to a key; returns a status line, "" for an unknown key.

    Raises UserError.
    """
    if key not in ("p", "c", "t"):
        return ""
    settings = snapshot(name)
    if key == "t" and settings.options.trace:
        return f"trace: {finish_trace(name)}"
    if key == "t":
        begin_trace(name, None)
        return "tracing: t ends it"
    words = {"p": "resume" if settings.paused else "pause", "c": "recentre"}
    ask(name, {"cmd": words[key]})
    return f"{words[key]}d"


def run(name: str, once: bool, as_json: bool) -> None:
    """Shows the session of that name: one state, JSON lines until it ends, or the screen in a
    terminal. Raises UserError if it is not running.
    """
    redraws = sys.stdout.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown")
    with closing(Watch(find(name))) as watch:
        if not as_json and (once or not redraws):
            print_state(watch.read())
        while as_json:
            print(json.dumps(watch.read().to_dict()), flush=True)  # noqa: T201
            if once or not watch.is_running():
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
    ages_ms = deque[float](maxlen=HISTORY)
    second = 0.0
    with (
        closing(Follower(name)) as follower,
        keyboard() as pressed,
        Live(screen=True, auto_refresh=False) as live,
    ):
        while True:
            now = time.monotonic()
            sample = follower.read()
            if sample is not None and now - second >= 1.0:
                second = now
                ages_ms.append(sample.metrics.end_to_end["p50_ms"])
            live.update(
                screen_view(name, sample, note if now < note_end else "", ages_ms), refresh=True
            )
            while left_s := max(0.0, now + PERIOD_S - time.monotonic()):
                try:
                    key = pressed(left_s)
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
