"""The ring with real processes: nothing torn, every drop counted, a killed writer does no harm."""

import contextlib
import multiprocessing
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.eyes import EYES
from lfpipe.host.files import SHM_DIR
from lfpipe.transport import ring
from lfpipe.transport.ring import Reader, RingSpec, Writer
from tests.support.examples import examples

SPAWN = multiprocessing.get_context("spawn")


@contextlib.contextmanager
def memory(spec: RingSpec) -> Iterator[Path]:
    """A ring of its own."""
    path = SHM_DIR / f"lfpipe-test-{secrets.token_hex(8)}.ring"
    shared = ring.create(path, spec)
    yield path
    shared.remove()


@pytest.fixture
def made() -> Iterator[Path]:
    with memory(RingSpec((96, 512), np.dtype("u1"), slots=4)) as path:
        yield path


@contextlib.contextmanager
def ends(spec: RingSpec) -> Iterator[tuple[Writer, Reader]]:
    """Both ends of a ring of its own."""
    with memory(spec) as path:
        writer = Writer(path)
        reader = Reader(path)
        yield writer, reader
        writer.close()
        reader.close()


def stop_in_mid_slot(path: Path, told: Any) -> None:
    writer = Writer(path)
    writer.begin()[:] = 7
    writer.publish(1, 10, 20)
    writer.begin()[:48] = 99
    told.send("half")
    told.recv()  # until it is killed


def test_writer_killed_in_mid_slot_harms_nobody(made: Path) -> None:
    ours, theirs = SPAWN.Pipe()
    reader = Reader(made)
    out = np.empty((96, 512), np.uint8)
    writer = SPAWN.Process(target=stop_in_mid_slot, args=(made, theirs), daemon=True)
    writer.start()
    assert ours.poll(60) and ours.recv() == "half"
    writer.kill()
    writer.join(60)
    stamp = reader.read(out)
    assert stamp is not None and stamp.seq == 1 and (out == 7).all()
    assert reader.read(out) is None
    successor = Writer(made)
    assert successor.epoch == 1
    successor.begin()[:] = 8
    successor.publish(2, 30, 40)
    stamp = reader.read(out)
    assert (
        stamp is not None
        and (stamp.seq, stamp.epoch, stamp.skipped) == (2, 1, 0)
        and (out == 8).all()
    )
    successor.close()
    reader.close()


@examples(60)
@given(steps=st.lists(st.integers(0, 9), min_size=1, max_size=30), slots=st.integers(3, 6))
def test_read_takes_or_counts_every_slot(steps: list[int], slots: int) -> None:
    out = np.empty((), EYES)
    published = read = skipped = 0
    with ends(RingSpec((), EYES, slots)) as (writer, reader):
        for burst in steps:
            for _ in range(burst):
                writer.begin()["confidence"] = published
                assert (
                    writer.publish(published, published * 3, published * 5, epoch=9)
                    == published + 1
                )
                published += 1
            stamp = reader.read(out)
            assert (stamp is None) == (burst == 0)
            if stamp is not None:
                read, skipped = read + 1, skipped + stamp.skipped
                assert float(out["confidence"]) == published - 1 == stamp.source_seq
                assert (stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch) == (
                    (published - 1) * 3,
                    (published - 1) * 5,
                    9,
                )
    assert read + skipped == published


@examples(60)
@given(
    steps=st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=30),
    slots=st.integers(3, 6),
)
@pytest.mark.parametrize("lent", [False, True])
def test_read_next_takes_every_slot_that_is_still_there(
    lent: bool, steps: list[tuple[int, int]], slots: int
) -> None:
    """steps: so many published, then so many asked for. slots - 2 may lie between the newest and
    the oldest still read.
    """
    out = np.empty(2, np.int64)
    published = last = 0
    with ends(RingSpec((2,), np.dtype("<i8"), slots)) as (writer, reader):
        for burst, asked in steps:
            for _ in range(burst):
                writer.begin()[:] = published
                writer.publish(published, 0, 0)
                published += 1
            for _ in range(asked):
                expected = max(last + 1, published - slots + 2)
                if lent:
                    peeked = reader.peek(in_order=True)
                    stamp, value = (None, -1) if peeked is None else (peeked[0], int(peeked[1][0]))
                    del peeked
                else:
                    stamp = reader.read_next(out)
                    value = int(out[0])
                assert (stamp is None) == (last == published)
                if stamp is not None:
                    assert (stamp.seq, stamp.source_seq, value) == (
                        expected,
                        expected - 1,
                        expected - 1,
                    )
                    assert stamp.skipped == expected - last - 1
                    last = stamp.seq


def test_reader_refuses_what_is_no_ring(tmp_path: Path) -> None:
    path = tmp_path / "a.ring"
    path.write_bytes(bytes(8192))
    with pytest.raises(ValueError, match="not a ring of this version"):
        Reader(path)


def test_reader_cannot_write_nor_close_while_lent(
    made: Path,
) -> None:
    reader = Reader(made)
    with pytest.raises(ValueError, match="read-only"):
        reader._payloads[0][:] = 1
    view = reader._payloads[0]
    with pytest.raises(BufferError):
        reader.close()
    assert view[0, 0] == 0
    del view
    reader._memory.close()
