"""A session's state as text for people: `lfpipe monitor`, `ctl status`, and the end of `lfpipe up`. Reads neither session nor
keyboard."""

from collections.abc import Mapping
from datetime import timedelta
from typing import Any

from rich.console import Console
from rich.text import Text

STATE_STYLE = {"RUNNING": "green", "STARTING": "yellow", "STOPPING": "yellow", "DEAD": "bold red"}
KEYS_LINE = "q quit  p pause  r reset  t trace  w warp  m mode  c recentre"
QUANTILES = ("p50_ms", "p95_ms", "p99_ms")


def ms(value: float) -> str:
    """A time in ms in five characters, with as many decimals as fit."""
    return f"{value:5.2f}" if value < 99.995 else f"{value:5.1f}" if value < 999.95 else f"{value:5.0f}"


def photon_words(latency: Mapping[str, float | None]) -> str:
    """`onset 61.2 ms, steady 4.0 ms` of `motion_to_photon`, as far as they are known."""
    return ", ".join(f"{key.removesuffix('_ms')} {value:.1f} ms" for key, value in latency.items() if value is not None)


def state_text(state: Mapping[str, Any]) -> Text:
    """The table of stages (rate, wait, busy, drops, restarts, load if it is known), quality, and the age of the picture.

    state: see `snapshot`. At most 80 cells wide.
    """
    out = Text(no_wrap=True, overflow="crop")
    uptime = timedelta(seconds=int(state["uptime_s"]))
    out.append(f"up {uptime}  camera {state['camera_fps']:.1f} Hz  ")
    if state["camera_light"]:
        out.append(f"{state['camera_light']}  ", "bold yellow")
    out.append(f"viewer {state['viewer']}\n", "green" if state["stages"].get("track", {}).get("face") else "bold yellow")
    out.append(f"{'ms':>22}   wait                busy\n", "bold")
    names = [name.removesuffix("_ms") for name in QUANTILES]
    times = "".join(f"{name:>6}" for name in (names[0], names[1], *names, "max"))
    out.append(f"{'stage':<8}{'state':<9}{'Hz':>5}{times} drops rst{' cpu%  MB' if 'cpu_percent' in state else ''}\n", "bold")
    stages = {name: stage for name, stage in state["stages"].items() if stage["state"] != "NONE"}
    for name, stage in stages.items():
        waits, busies = ([stage[kind][each] for each in QUANTILES] for kind in ("wait", "busy"))
        times = "".join(f" {ms(value)}" for value in (*waits[:2], *busies, stage["busy"]["max_ms"]))
        out.append(f"{name:<8}").append(f"{stage['state'].lower():<9}", STATE_STYLE.get(stage["state"], ""))
        out.append(f"{stage['fps']:5.1f}{times}").append(f" {stage['dropped']:5d}", "bold red" if stage["dropped"] else "")
        out.append(f" {stage['restarts']:3d}", "bold red" if stage["restarts"] else "").append(f"{_load(stage)}\n")
        if stage["busy_with"]:
            out.append(f"{'':<8}{stage['busy_with']}\n", "yellow")
    if "cpu_percent" in state:
        out.append(f"{'supervisor':<68}{_load(state)}\n", "dim")
    level = f"level {state['level']} of {state['lowest_level']}" if state["level"] else "full"
    out.append(f"quality {level}\n", "bold yellow" if state["level"] else "dim")
    for notice in state["notices"]:
        out.append(f"now: {notice}\n", "bold yellow")
    return out.append_text(_age(state))


def _load(load: Mapping[str, Any]) -> str:
    return f" {load['cpu_percent']:4.0f}{load['rss_mb']:4.0f}" if "cpu_percent" in load else ""


def _age(state: Mapping[str, Any]) -> Text:
    out, age, judder, ahead = Text(), state["end_to_end"], state["judder"], state["horizon"]
    if age["n"]:
        out.append(f"age of the picture at {'its blank' if judder['planned'] else 'hand-over'}", "bold")
        out.append("; the delays of camera and display are not in it:\n")
        out.append("  " + ", ".join(f"{each.removesuffix('_ms')} {age[each]:.2f}" for each in (*QUANTILES, "max_ms")))
        out.append(f" ms over {age['n']} pictures\n")
    if judder["planned"]:
        out.append(f"judder: {judder['percent']:.2f} % of {judder['planned']} refreshes showed another picture than planned\n")
    if ahead["n"]:
        out.append(f"eyes predicted ahead of the sensor by p50 {ahead['p50_ms']:.2f}, p95 {ahead['p95_ms']:.2f} ms\n")
    if words := photon_words(state["motion_to_photon"]):
        out.append(f"motion to photon: {words}\n")
    return out


def print_state(state: Mapping[str, Any]) -> None:
    """Prints the state on stdout."""
    console = Console(highlight=False, soft_wrap=True)
    console.print(Text.assemble("session ", (str(state["session"]), "bold")).append("  ").append_text(state_text(state)), end="")


def waiting_text(session: str) -> Text:
    """The screen of a monitor without a session."""
    return Text.assemble(("lfpipe ", "bold"), (session, "bold"), "  no session; waiting for one (q quits)\n")


def screen_text(state: Mapping[str, Any], hello: Mapping[str, Any], note: str) -> Text:
    """The whole screen of a monitor. state: see `Watch.read_window`. hello: the session's answer to `hello`, empty if there is
    none. note: the answer to the last key."""
    out = Text.assemble(("lfpipe ", "bold"), (state["session"], "bold cyan"), "  ", no_wrap=True, overflow="crop")
    if hello:
        out.append("PAUSED  " if hello["paused"] else "", "bold yellow")
        render, timeline = hello["config"]["render"], hello["options"].get("timeline", "")
        alpha = render["alpha_px"] if isinstance(render["alpha_px"], str) else f"{render['alpha_px']:.1f}"
        out.append(f"{render['method']} views, {render['anaglyph']} anaglyph, alpha {alpha}", "dim")
        out.append(f"\nrecording timeline {timeline}" if timeline else "", "dim")
    out.append("\n").append_text(state_text(state)).append(f"{note or KEYS_LINE}\n", "bold" if note else "dim")
    return out.append("times of the last 10 s; rst: restarts", "dim")
