"""A session's state as a table for people."""

import textwrap
from typing import Any

from lfpipe.supervisor.snapshot import ms, photon_words, placed

COLUMNS = 80
QUANTILES = ("p50", "p95", "p99")


def latency_table(state: dict[str, Any]) -> None:
    """Prints stages (rate, wait, busy, drops, restarts) and the age of the picture when presented, on stdout, in 80 columns."""
    light = f" ({state['camera_light']})" if state["camera_light"] else ""
    print(f"session {state['session']}, {state['uptime_s']:.1f} s, camera {state['camera_fps']:.1f} Hz{light}")
    print(f"\n{'':<23}{'wait ms':<18}{'busy ms'}")
    times = "".join(f"{name:>6}" for name in (*QUANTILES, *QUANTILES, "max"))
    print(f"{'stage':<8}{'state':<9}{'Hz':>5}{times} drops restarts".rstrip())
    for name, stage in state["stages"].items():
        if stage["state"] == "NONE":
            continue
        waits, busies = ([stage[kind][f"{each}_ms"] for each in QUANTILES] for kind in ("wait", "busy"))
        times = "".join(f" {ms(value)}" for value in (*waits, *busies, stage["busy"]["max_ms"]))
        print(f"{name:<8}{stage['state'].lower():<9}{stage['fps']:5.1f}{times} {stage['dropped']:5d} {stage['restarts']:8d}")
        if stage["busy_with"]:
            print(f"{'':<8}{stage['busy_with']}")
    print(f"\nquality: {state['level_words']} (level {state['level']} of {state['lowest_level']})")
    for notice in state["notices"]:
        print(f"now: {notice}")
    running = {name: stage for name, stage in state["stages"].items() if stage["cpus"]}
    cores = ", ".join(placed(name, stage["cpus"], stage["nice"]) for name, stage in running.items())
    print(textwrap.fill(cores, COLUMNS, initial_indent="cores: ", subsequent_indent=" " * 7))
    age = state["end_to_end"]
    if age["n"]:
        print(
            f"age of the picture at {'its blank' if state['judder']['planned'] else 'hand-over'}; "
            "the delays of camera and display are not in it:\n"
            f"  p50 {age['p50_ms']:.2f}, p95 {age['p95_ms']:.2f}, "
            f"p99 {age['p99_ms']:.2f}, max {age['max_ms']:.2f} ms over {age['n']} pictures"
        )
    judder = state["judder"]
    if judder["planned"]:
        print(f"judder: {judder['percent']:.2f} % of {judder['planned']} refreshes showed another picture than planned")
    ahead = state["horizon"]
    if ahead["n"]:
        print(f"eyes predicted ahead of the sensor by p50 {ahead['p50_ms']:.2f}, p95 {ahead['p95_ms']:.2f} ms")
    if words := photon_words(state["motion_to_photon"]):
        print(f"motion to photon: {words}")
