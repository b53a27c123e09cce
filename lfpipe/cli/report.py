"""A session's state as a table for people."""

from __future__ import annotations

from typing import Any

from lfpipe.observe.snapshot import placed

COLUMNS = ("p50_ms", "p95_ms", "p99_ms", "max_ms")


def latency_table(state: dict[str, Any]) -> None:
    """Prints stages (rate, wait, busy, drops, restarts) and the age of the picture when presented, on stdout."""
    from rich.console import Console
    from rich.table import Table

    title = f"session {state['session']}, {state['uptime_s']:.1f} s, camera {state['camera_fps']:.1f} Hz"
    table = Table(title=title, title_justify="left")
    for name in ("stage", "state", "pid", "rate Hz"):
        table.add_column(name, justify="left" if name in ("stage", "state") else "right")
    for name in ("wait ms p50", "p95", "p99", "max", "busy ms p50", "p95", "p99", "max", "dropped", "restarts"):
        table.add_column(name, justify="right")
    for name, stage in state["stages"].items():
        if stage["state"] == "NONE":
            continue
        times = [f"{stage[kind][column]:.2f}" for kind in ("wait", "busy") for column in COLUMNS]
        head = (name, stage["state"].lower(), str(stage["pid"]), f"{stage['fps']:.1f}")
        table.add_row(*head, *times, str(stage["dropped"]), str(stage["restarts"]))
    console = Console(width=None if Console().is_terminal else 140)
    console.print(table)
    console.print(f"quality: {state['level_words']} (level {state['level']} of {state['lowest_level']})")
    running = {name: stage for name, stage in state["stages"].items() if stage["cpus"]}
    console.print(f"cores: {', '.join(placed(name, stage['cpus'], stage['nice']) for name, stage in running.items())}")
    age = state["end_to_end"]
    console.print(
        f"picture's age when presented, sensor to screen: p50 {age['p50_ms']:.2f}, p95 {age['p95_ms']:.2f}, "
        f"p99 {age['p99_ms']:.2f}, max {age['max_ms']:.2f} ms over {age['n']} pictures"
    )
    ahead = state["horizon"]
    if ahead["n"]:
        console.print(f"eyes predicted ahead of the sensor by p50 {ahead['p50_ms']:.2f}, p95 {ahead['p95_ms']:.2f} ms")
