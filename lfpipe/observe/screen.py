"""The terminal screen of `lfpipe monitor`, as one styled text. This module reads neither session nor keyboard."""

from __future__ import annotations

from collections import deque
from typing import Any

import attrs
from rich.text import Text

from lfpipe.observe.meter import Reading, StageReading
from lfpipe.supervisor.snapshot import ms, placed

SPARKS = "▁▂▃▄▅▆▇█"
EIGHTHS = " ▏▎▍▌▋▊▉█"
NARROWEST = 60
STATE_STYLE = {"RUNNING": "green", "STARTING": "yellow", "STOPPING": "yellow", "DEAD": "bold red"}
KEYS_LINE = "q quit  p pause  r reset  t trace  w warp  m mode  c recentre"


@attrs.frozen
class SessionActivity:
    """The session's settings, from `hello`. method: render.method. trace: the file of a running timeline."""

    method: str = ""
    anaglyph: str = ""
    alpha: str = ""
    paused: bool = False
    trace: str = ""

    @classmethod
    def of(cls, hello: dict[str, Any]) -> SessionActivity:
        """From the answer to `hello`."""
        render = hello["config"]["render"]
        alpha = render["alpha_px"] if isinstance(render["alpha_px"], str) else f"{render['alpha_px']:.1f}"
        trace = str(hello["options"].get("timeline", ""))
        return cls(render["method"], render["anaglyph"], alpha, bool(hello["paused"]), trace)


def bar(wait: float, busy: float, full: float, width: int) -> Text:
    """Wait (light) then busy (solid), in units of full, cut at width cells."""
    light = min(width, round(width * wait / full)) if full > 0 else 0
    eighths = min((width - light) * 8, round(8 * width * busy / full)) if full > 0 else 0
    solid = "█" * (eighths // 8) + (EIGHTHS[eighths % 8] if eighths % 8 else "")
    return Text.assemble(("░" * light, "yellow"), (solid, "cyan"), " " * (width - light - len(solid)))


def sparkline(values: list[float | None], width: int) -> str:
    """The last `width` values, scaled to their range; a dot for a missing value."""
    shown = values[-width:]
    known = [value for value in shown if value is not None]
    if not known:
        return "·" * len(shown)
    low, span = min(known), max(max(known) - min(known), 1e-9)
    return "".join("·" if v is None else SPARKS[min(7, int(8 * (v - low) / span))] for v in shown)


def _clock(seconds: float) -> str:
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def _stage_line(stage: StageReading, full_ms: float, width: int) -> Text:
    line = Text(f"{stage.name:<8}")
    line.append(f"{stage.state.lower():<9}", STATE_STYLE.get(stage.state, ""))
    busy = stage.busy
    line.append(f"{stage.rate_hz:5.1f} {ms(stage.wait.p50_ms)} {ms(busy.p50_ms)} {ms(busy.p95_ms)} {ms(busy.p99_ms)} ")
    line.append_text(bar(stage.wait.p50_ms, stage.busy.p50_ms, full_ms, width))
    line.append(f" {stage.dropped:5d}", "bold red" if stage.dropped else "")
    line.append(f" {stage.restarts:3d}", "bold red" if stage.restarts else "")
    line.append(f" {stage.cpu_percent:4.0f} {stage.rss_mb:4.0f}")
    if stage.busy_with:
        line.append(f"\n{'':<8}{stage.busy_with}", "yellow")
    return line


class Screen:
    """Keeps the history for the sparkline. session: its name."""

    def __init__(self, session: str, history: int = 240) -> None:
        self._session = session
        self._ages: deque[float | None] = deque(maxlen=history)
        self.note = ""  # the answer to the last key

    def reset(self) -> None:
        """Forgets the history."""
        self._ages.clear()

    def waiting(self) -> Text:
        """The screen without a session."""
        self._ages.clear()
        return Text.assemble(("lfpipe ", "bold"), (self._session, "bold"), "  no session; waiting for one (q quits)\n")

    def draw(self, reading: Reading, doing: SessionActivity, width: int) -> Text:
        """The whole screen, at most width cells wide; designed for 80, readable from NARROWEST on."""
        self._ages.append(reading.age_now_ms)
        width = max(width - 1, NARROWEST)
        bar_width = max(4, width - 67)
        full_ms = max((s.wait.p50_ms + s.busy.p50_ms for s in reading.stages), default=0.0)
        out = Text(no_wrap=True, overflow="crop")
        out.append_text(self._head(reading, doing))
        out.append(f"{'':<22} {'wait':>5} {'busy':>5}   ms\n", "bold")
        title = f"{'stage':<8}{'state':<9}{'Hz':>5} {'p50':>5} {'p50':>5} {'p95':>5} {'p99':>5} "
        scale = f"to {ms(full_ms).strip()} ms"
        out.append(f"{title}{scale[:bar_width]:<{bar_width}} {'drops':>5} {'rst':>3} {'cpu%':>4} {'MB':>4}\n", "bold")
        for stage in reading.stages:
            out.append_text(_stage_line(stage, full_ms, bar_width))
            out.append("\n")
        cpu, rss = reading.supervisor
        out.append(f"{'supervisor':<{57 + bar_width}} {cpu:4.0f} {rss:4.0f}\n", "dim")
        out.append_text(self._age(reading, width))
        out.append(f"\n{self.note or KEYS_LINE}\n", "bold" if self.note else "dim")
        out.append("times of the last 10 s; bars: wait ░ and busy █, medians; rst: restarts", "dim")
        return out

    def _head(self, reading: Reading, doing: SessionActivity) -> Text:
        head = Text.assemble(("lfpipe ", "bold"), (self._session, "bold cyan"), f"  up {_clock(reading.uptime_s)}")
        head.append(f"  camera {reading.camera_hz:.1f} Hz  ")
        if reading.camera_light:
            head.append(f"{reading.camera_light}  ", "bold yellow")
        head.append(f"viewer {reading.viewer}", "green" if reading.face else "bold yellow")
        if doing.paused:
            head.append("  PAUSED", "bold yellow")
        head.append("\n")
        if doing.method:
            traced = f", recording timeline {doing.trace}" if doing.trace else ""
            head.append(f"{doing.method} views, {doing.anaglyph} anaglyph, alpha {doing.alpha}{traced}\n", "dim")
        cores = ", ".join(placed(stage.name, stage.cpus, stage.nice) for stage in reading.stages if stage.cpus)
        head.append(f"cores {cores}; ", "dim")
        if reading.level:
            head.append(f"lowered to level {reading.level} of {reading.lowest_level}:\n{reading.level_words}\n", "bold yellow")
        else:
            head.append("full quality\n", "dim")
        return head.append("\n")

    def _age(self, reading: Reading, width: int) -> Text:
        age, worst = reading.age, reading.worst
        out = Text("\nage of pictures   ", "bold")
        out.append(f"p50 {age.p50_ms:.1f}  p95 {age.p95_ms:.1f}  p99 {age.p99_ms:.1f}  max {age.max_ms:.1f} ms", "")
        out.append(f"   worst {worst.max_ms:.1f} ms\n", "dim")
        ahead = reading.horizon
        if reading.judder_percent is not None:
            out.append("judder            ", "bold").append(f"{reading.judder_percent:.2f} % of refreshes so far\n")
        out.append("eyes predicted by ", "bold")
        out.append(f"p50 {ahead.p50_ms:.1f}  p95 {ahead.p95_ms:.1f} ms\n" if ahead.n else "nothing yet\n")
        if reading.motion_to_photon:
            out.append("motion to photon  ", "bold").append(f"{reading.motion_to_photon}\n")
        known = [value for value in self._ages if value is not None]
        ends = f" {min(known):.1f}-{max(known):.1f} ms" if known else ""
        return out.append(sparkline(list(self._ages), width - 18), "cyan").append(f"{ends}\n", "dim")
