"""Python functions that one camera frame runs through in the stages capture, track and render.

    python -m profiling.functions_per_frame [--config paper] [--set KEY=VALUE]... [--list]

A session without a display plays the demo's sequence at 30 Hz; after two seconds, each stage counts
calls until it has completed FRAMES outputs. Printed per stage: functions of lfpipe that ran, calls
of them per camera frame, and calls of functions of libraries. --list: also each function with its
calls per frame.
"""

import collections
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import attrs

from lfpipe.bench.inputs import MOVING_S, demo_sequence
from lfpipe.config import load
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.demo import demo_scene
from lfpipe.transport.context import Context
from profiling.arguments import parser_of, start

FRAMES, WARM_UP = 30, 60
FOLDER = "LFPIPE_FUNCTIONS"
STAGES = ("capture", "track", "render")


def count(context: Context, run: Callable[[Context], None]) -> None:
    """Runs a stage and writes {function: calls per camera frame} once FRAMES are counted."""
    calls: collections.Counter[Any] = collections.Counter()
    frames: list[int] = []
    wait = context.wait

    def event(frame: FrameType, what: str, _: object) -> None:
        if what == "call":
            calls[frame.f_code] += 1

    def counted(*args: Any, **more: Any) -> bool:
        sys.setprofile(None)
        done = context.row["source_seq"]
        if done >= WARM_UP and not frames:
            frames.append(done)
            calls.clear()
        elif len(frames) == 1 and done >= frames[0] + FRAMES:
            frames.append(done)
            passed = done - frames[0]
            each = {
                f"{code.co_filename}:{code.co_firstlineno} {code.co_qualname}": n / passed
                for code, n in calls.items()
            }
            Path(os.environ[FOLDER], context.spec.name).write_text(json.dumps(each))
        if len(frames) == 1:
            sys.setprofile(event)
        return wait(*args, **more)

    context.wait = counted  # type: ignore[method-assign]
    run(context)


def main(context: Context | None = None) -> None:
    """With a context: the stage of that name, counted."""
    if context is not None:
        from importlib import import_module

        count(context, import_module(f"lfpipe.{context.spec.name}.stage").main)
        return
    parser = parser_of(__doc__)
    parser.add_argument("--config")
    parser.add_argument("--set", dest="sets", action="append", default=[])
    parser.add_argument("--list", action="store_true")
    args = parser.parse_args()
    cache = cache_dir(load().scene)
    video = demo_sequence(cache / "bench", MOVING_S[1])
    scene = demo_scene(cache)
    options = [f"--set={text}" for text in args.sets] + (
        ["--config", args.config] if args.config else []
    )
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            __file__,
            "up",
            str(scene),
            "--camera",
            f"file:{video}?loop=1&pace=30",
            "--display",
            "none",
        ]
        process = subprocess.Popen(
            [*command, *options], env=os.environ | {FOLDER: folder}, stdout=subprocess.DEVNULL
        )
        end = time.monotonic() + 60
        while (
            process.poll() is None
            and time.monotonic() < end
            and len(list(Path(folder).iterdir())) < len(STAGES)
        ):
            time.sleep(0.2)
        process.terminate()
        process.wait()
        every: set[str] = set()
        for name in STAGES:
            calls = json.loads(Path(folder, name).read_text())
            own = {key: n for key, n in calls.items() if "/lfpipe/" in key and n >= 0.5}
            every |= own.keys()
            print(
                f"{name:8} {len(own):4} functions, {sum(own.values()):6.1f} calls a frame,", end=" "
            )
            print(f"{sum(calls.values()) - sum(own.values()):5.1f} of libraries")
            for key, n in sorted(calls.items(), key=lambda item: -item[1]) if args.list else ():
                print(f"  {n:6.2f} {key.rpartition('/lfpipe/')[2]}")
        print(f"{'together':8} {len(every):4} functions, those of several stages once")


if __name__ == "__main__":
    if os.environ.get(FOLDER):
        from lfpipe.cli import run
        from lfpipe.supervisor import process_table

        sys.path.insert(0, str(Path(__file__).parent))
        process_table.STAGES = tuple(
            attrs.evolve(row, module="functions_per_frame") if row.name in STAGES else row
            for row in process_table.STAGES
        )
        run()
    else:
        start(main)
