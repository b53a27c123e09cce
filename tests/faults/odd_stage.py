"""A stage that option "source" makes slow or hung at its end."""

import time
from pathlib import Path

from lfpipe.transport.context import Context


def main(context: Context) -> None:
    context.ready()
    context.row["seq"] = 77
    while context.wait():
        pass
    if context.options.source == "saves":
        with context.saving("writing what is left"):
            end = time.monotonic() + 3.0  # more than a stage may take for its end
            while time.monotonic() < end:
                (Path(context.options.timeline) / "saved").write_text("x" * 10_000)
                time.sleep(0.05)
        context.row["seq"] = 78
    elif context.options.source == "hangs at its end":
        time.sleep(1000)
