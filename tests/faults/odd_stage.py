"""A stage controlled by option "does": slow in one way, or hung in another."""

import os
import signal
import time
from pathlib import Path

from lfpipe.transport.context import Context

FIFO = "blocks"


def _spin(seconds: float) -> None:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def main(context: Context) -> None:
    does, for_s = context.options.source, context.options.source_hz
    fifo = Path(context.options.still) / FIFO
    if does == "computes before it is ready":
        _spin(for_s)
    elif does == "is stopped before it is ready":
        os.kill(os.getpid(), signal.SIGSTOP)
    elif does == "sleeps before it is ready":
        time.sleep(1000)
    context.ready()
    for _ in range(10):
        context.wait()
    if does == "spins":
        _spin(1000)
    elif does == "is stopped":
        os.kill(os.getpid(), signal.SIGSTOP)
    elif does == "waits for a file":
        with context.busy_with("reading a slow file"):
            fifo.read_bytes()
    elif does == "waits for a file and says nothing":
        fifo.read_bytes()
    elif does == "computes for another scene":
        with context.setting_up("opening the scene"):
            _spin(for_s)
    context.row["seq"] = 77  # it came through
    while context.wait():
        pass
    if does == "saves":
        with context.saving("writing what is left"):
            end = time.monotonic() + for_s
            while time.monotonic() < end:
                (fifo.parent / "saved").write_text("x" * 10_000)
                time.sleep(0.05)
        context.row["seq"] = 78
    elif does == "hangs at its end":
        time.sleep(1000)
