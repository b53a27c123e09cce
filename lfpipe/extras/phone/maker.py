"""Makes a light field of a clip in a child process with limits on memory and time.

`python -m lfpipe.extras.phone.maker`, by `make_in_child`. Its request is {"path", "out"}, its steps
are {"step", "done", "total"}, and its result is the `Slide`.
"""

import contextlib
from pathlib import Path
from typing import Any

import attrs

from lfpipe.extras.phone.slide import Slide, make_slide
from lfpipe.host.worker import Report, Worker, serve
from lfpipe.scene.pack import SILENT_S
from lfpipe.scene.packer import MEMORY_BYTES
from lfpipe.scene.source import Progress


class _Maker(Worker):
    """The child at work. progress: receives its steps."""

    def __init__(self, path: Path, out: Path, progress: Progress) -> None:
        self._progress = progress
        request = {"path": str(path), "out": str(out)}
        super().__init__("lfpipe.extras.phone.maker", request, str(path), SILENT_S)

    def on_step(self, step: dict[str, Any]) -> None:
        """Passes a step on."""
        self._progress(step["step"], step["done"], step["total"])


def make_in_child(path: Path, out: Path, progress: Progress) -> Slide:
    """As `make_slide`, in a child process. Raises UserError."""
    with contextlib.closing(_Maker(path, out, progress)) as maker:
        maker.wait()
        return Slide(**maker.result())


def work(request: dict[str, Any], report: Report) -> dict[str, Any]:
    """In the child: makes the light field. Raises UserError."""

    def progress(what: str, done: int, total: int) -> None:
        report(step=what, done=done, total=total)

    return attrs.asdict(make_slide(Path(request["path"]), Path(request["out"]), progress))


if __name__ == "__main__":
    serve(work, MEMORY_BYTES)
