"""Slow, full or missing disks, and unplanned ends: the session continues, and the recording is
readable.
"""

import json
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lfpipe import config
from lfpipe.config.session_options import CameraViewer
from lfpipe.sequence import recorder
from lfpipe.sequence.folder import open_sequence
from lfpipe.sequence.packets import encoded
from lfpipe.sequence.recorder import Recordable, Recording
from lfpipe.transport.control import Session
from lfpipe.transport.ring import Reader
from tests.replay.test_record import frames
from tests.support.world import LARGE, World

SMALL = (
    "--set",
    "camera.width_px=160",
    "--set",
    "camera.height_px=120",
    "--set",
    "camera.rate_hz=60",
)
SHAPE = (120, 160, 3)


def test_the_death_of_the_supervisor_loses_no_frame_that_the_recorder_had(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = world.root / "rec"
    monkeypatch.setenv("LFPIPE_RUN_DIR", str(world.run_dir))
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


def test_a_recorder_that_is_killed_goes_on_in_the_same_folder(world: World, scene: Path) -> None:
    out = world.root / "rec"
    process = world.shows(scene, *SMALL)
    world.ctl("record", "start", out)
    world.wait_for(lambda: frames(out) > 20, "frames")
    before = frames(out)
    world.kill("capture")
    world.wait_for(lambda: frames(out) > before + 20, "frames of the next one")
    world.ctl("record", "stop")
    world.wait_for(lambda: json.loads((out / "manifest.json").read_text())["complete"], "manifest")
    packets = open_sequence(out).packets
    assert len({packet.epoch for packet in packets}) == 2 and len(packets) > before + 20
    stamps = [packet.t_sensor_ns for packet in packets]
    assert stamps == sorted(stamps)
    world.ended(process, signal.SIGINT)


def frame(number: int, level: int = 1) -> Recordable:
    t_ns = 10**9 + number * 10**7
    picture = np.full(SHAPE, level, np.uint8)
    return Recordable(source_seq=number, epoch=0, t_sensor_ns=t_ns, t_read_ns=t_ns, data=picture)


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Recording]:
    context = SimpleNamespace(
        config=config.load(),
        options=SimpleNamespace(viewer=CameraViewer(source="demo", rate_hz=30.0)),
    )
    recording = Recording(context, tmp_path / "rec", SHAPE[1::-1])  # type: ignore[arg-type]
    yield recording
    recording.end()  # else the thread of a test that failed would keep this process


def test_any_error_in_the_thread_ends_the_recording_with_a_message(
    made: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(recorder, "encoded", lambda frame, codec: b"" if frame.any() else fails())
    for number, level in enumerate((1, 0, 1)):
        made.add(frame(number, level))
    made.end()
    made.thread.join()
    assert made.failure == "MemoryError" and made.writer.count == 1 and not made.full
    assert not made.add(frame(9)) and made.missed in (1, 2), "the third one may come too late, too"


def test_frames_without_space_are_missed_and_the_others_keep_their_order(
    made: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = threading.Event()
    monkeypatch.setattr(
        recorder, "encoded", lambda frame, codec: gate.wait(30) and encoded(frame, codec)
    )
    made._max_frames = recorder.MIN_FRAMES
    assert made.add(frame(0)) and not made.add(frame(0)), "a repeated stamp cannot be replayed"
    count = 1
    while made.add(frame(count)):
        count += 1
    assert made.full and recorder.MIN_FRAMES <= count <= recorder.MIN_FRAMES + 1
    gate.set()
    made.end()
    made.thread.join()
    sequence = open_sequence(made.folder)
    assert [packet.source_seq for packet in sequence.packets] == list(range(count))
    assert sequence.complete and made.missed == 2
