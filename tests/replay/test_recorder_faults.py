"""Slow, full or missing disks, and unplanned ends: the session continues, and the recording is
readable.
"""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lfpipe.record import stage
from lfpipe.record.stage import Store
from lfpipe.sequence.folder import SequenceWriter, open_sequence
from lfpipe.sequence.packets import encoded
from lfpipe.transport.ring import Reader, Stamp
from lfpipe.transport.session import Session
from tests.replay.test_record import frames, recorder
from tests.support.world import LARGE, World, stays, until

SMALL = (
    "--set",
    "camera.width_px=160",
    "--set",
    "camera.height_px=120",
    "--set",
    "camera.rate_hz=60",
)
SHAPE = (120, 160, 3)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own, on a disk that can be stopped."""
    image, place = tmp_path / "disk.img", tmp_path / "disk"
    place.mkdir()
    with image.open("wb") as file:
        file.truncate(64 << 20)
    made = [["mkfs.ext4", "-q", str(image)], ["mount", "-o", "loop", str(image), str(place)]]
    if os.getuid() or not all(
        shutil.which(command[0]) and not subprocess.run(command).returncode for command in made
    ):
        pytest.skip(
            "no file system can be made and mounted here (needs root, mkfs.ext4 and loop devices)"
        )
    yield place
    subprocess.run(["fsfreeze", "-u", str(place)], capture_output=True)
    umount = ["umount", str(place)]
    until(lambda: subprocess.run(umount, capture_output=True).returncode == 0, "end of its use")


@contextlib.contextmanager
def stopped(disk: Path) -> Iterator[None]:
    """Every write waits in the kernel, as with a network drive whose server is gone."""
    subprocess.run(["fsfreeze", "-f", str(disk)], check=True)
    try:
        yield
    finally:
        subprocess.run(["fsfreeze", "-u", str(disk)], check=True)


def test_a_disk_that_stalls_costs_nothing_and_nobody_is_killed(
    world: World, scene: Path, disk: Path
) -> None:
    process = world.shows(scene, *SMALL)
    out = disk / "rec"
    world.ctl("record", "start", out)
    world.wait_for(lambda: frames(out) > 30, "frames")
    with stopped(disk):
        world.wait_for(
            lambda: str(recorder(world)["busy_with"]).startswith("waiting for the disk"), "words"
        )
        waiting = recorder(world)["pid"]
        # longer than a stage may be silent
        stays(lambda: recorder(world)["pid"] == waiting, 4.0, "the recorder")
    stored = frames(out)
    world.wait_for(
        lambda: frames(out) > stored + 30 and not recorder(world)["busy_with"], "frames again"
    )
    world.ctl("record", "stop")
    world.wait_for(lambda: json.loads((out / "manifest.json").read_text())["complete"], "manifest")
    world.wait_for(lambda: recorder(world)["state"] == "FINISHED", "end of the recorder")
    stages = world.monitor()["stages"]
    assert [stage["restarts"] for stage in stages.values()] == [0] * 4
    assert open_sequence(out).lost <= stages["capture"]["dropped"] + stages["record"]["dropped"], (
        "every hole is counted"
    )
    world.ended(process, signal.SIGINT)


def test_the_death_of_the_supervisor_loses_no_frame_that_the_recorder_had(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = world.root / "rec"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(world.run_dir))
    process = world.start("record", out, "--camera", "demo", *LARGE)
    world.wait_for(lambda: frames(out) > 20, "frames")
    ring = Reader(Session(f"record.{process.pid}").segment("frames"))
    process.kill()
    process.wait(60)
    world.wait_for(
        lambda: json.loads((out / "manifest.json").read_text())["complete"],
        "end of the recording",
    )
    seqs = [packet.source_seq for packet in open_sequence(out).packets]
    assert len(seqs) > 20
    picture = np.empty(ring.shape, ring.dtype)
    ring.last_seq = 0
    newest = ring.read(picture)
    assert newest is not None and newest.source_seq - seqs[-1] <= ring.slots, (
        "only what was under way"
    )
    ring.close()


def stamp(number: int) -> Stamp:
    return Stamp(number + 1, number, 0, 10**9 + number, 10**9 + number, 10**9 + number, 0)


def made(folder: Path) -> tuple[SequenceWriter, Store]:
    writer = SequenceWriter(folder, "demo", SHAPE[1::-1], 30.0)
    return writer, Store(writer, 3 * SHAPE[0] * SHAPE[1], lossless=True)


def test_any_error_in_the_thread_ends_the_recording_with_a_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(stage, "encoded", lambda frame, codec: b"" if frame.any() else fails())
    writer, store = made(tmp_path)
    for number, picture in enumerate(
        (np.ones(SHAPE, np.uint8), np.zeros(SHAPE, np.uint8), np.ones(SHAPE, np.uint8))
    ):
        store.put(stage.Frame(stamp(number), "", picture))
    store.close()
    assert (
        store.failure == "MemoryError"
        and writer.count == len(list(store.results())) == 1
        and not store.full
    )


def test_a_full_store_empties_itself_and_keeps_the_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stage, "BUFFER_BYTES", 0)  # as few frames as there may be
    gate = threading.Event()
    monkeypatch.setattr(
        stage, "encoded", lambda frame, codec: gate.wait() and encoded(frame, codec)
    )
    _, store = made(tmp_path)
    count = 0
    while not store.full:
        store.put(stage.Frame(stamp(count), "", np.zeros(SHAPE, np.uint8)))
        count += 1
    gate.set()
    store.close()
    assert [done.source_seq for done, *_ in store.results()] == list(
        range(count)
    ) and not store.full
