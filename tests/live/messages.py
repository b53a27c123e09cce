"""Refusals of live light fields."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import attrs
import numpy as np

import lfpipe
from lfpipe.capture.open_source import RingSource, check_devices, check_live
from lfpipe.config import Config
from lfpipe.config.session_options import CameraViewer
from lfpipe.errors import UserError
from lfpipe.live.records import directory_of, scene_dtype, scene_of
from lfpipe.supervisor import rundir
from lfpipe.transport import ring
from lfpipe.transport.ring import DESCRIPTION, RingSpec
from tests.live import made

NAME = f"bad_{os.getpid()}"


@contextlib.contextmanager
def written(dtype: np.dtype[np.void]) -> Iterator[memoryview]:
    """A ring with records of that type."""
    lock = rundir.acquire_directory(directory_of(NAME), UserError("in use", ""))
    memory = ring.create(scene_of(NAME), RingSpec((), dtype, 4))
    try:
        yield memory.buf
    finally:
        rundir.remove(directory_of(NAME), lock)


def of_another_version(_: Path) -> None:
    with written(np.dtype([("views", "u1", (1, 2, 48, 64, 3))])):
        check_live(f"live:ring:{NAME}", Config())


def damaged(_: Path) -> None:
    with written(scene_dtype(1, 2, (64, 48))) as buffer:
        buffer[DESCRIPTION : DESCRIPTION + 4] = b"{,,,"
        check_live(f"live:ring:{NAME}", Config())


def without_its_program(_: Path) -> None:
    program = f"""
import os, lfpipe
lfpipe.LiveScene({NAME!r}, rows=1, cols=2, size_px=(64, 48))
os._exit(1)
"""
    subprocess.run([sys.executable, "-c", program], timeout=60)
    try:
        check_live(f"live:ring:{NAME}", Config())
    finally:
        lfpipe.LiveScene(NAME, rows=1, cols=2, size_px=(64, 48)).close()


def with_other_views(_: Path) -> None:
    with lfpipe.LiveScene(NAME, rows=1, cols=2, size_px=(64, 48)):
        RingSource(NAME).read(np.empty((48, 64, 3), np.uint8))


def one_device(_: Path) -> None:
    live = attrs.evolve(made.source(), source="camera:2")
    check_devices("live:/dev/video2", live, CameraViewer(source="camera:/dev/video2"))


VERSION = "its records are not those of this version … the same version of lfpipe in both"
MESSAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "a ring of another version": (of_another_version, f"ring:{NAME}: {VERSION}"),
    "a ring that is damaged": (damaged, f"ring:{NAME}: {VERSION}"),
    "no ring": (
        lambda _: check_live(f"live:ring:{NAME}", Config()),
        f"ring:{NAME}: no such live scene … start the program that draws it",
    ),
    "a ring without its program": (
        without_its_program,
        f"ring:{NAME}: its program has ended … start it again",
    ),
    "a program with other views": (
        with_other_views,
        f"ring:{NAME}: its program draws 1x2 views of 64x48 px now … start it again",
    ),
    "one device for viewer and scene": (
        one_device,
        "live:/dev/video2: this camera already tracks your eyes … --camera mouse",
    ),
}
