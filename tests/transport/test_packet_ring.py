"""JPEGs beside their frames: each comes with the frame it was decoded into, whatever is missing on
either side.
"""

import secrets
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.config import SessionOptions
from lfpipe.transport import ring
from lfpipe.transport.packet_ring import PacketInput, PacketOutput, packet_dtype
from lfpipe.transport.ring import RingSpec, Stamp
from lfpipe.transport.session import Session

MAX_BYTES, SLOTS, MANY = 64, 6, 100
KINDS = "both", "no packet", "too large", "frame not asked for"


def data(seq: int, size: int = 10) -> np.ndarray:
    return np.full(size, seq % 251, np.uint8)


def stamp(seq: int, epoch: int = 0) -> Stamp:
    return Stamp(seq + 1, seq, epoch, seq * 10, seq * 10, seq * 10, 0)


@contextmanager
def ends() -> Iterator[tuple[Session, PacketOutput, PacketInput]]:
    """A session with two rings of packets; an output that nobody has asked yet, and an input of the
    first ring.
    """
    session = Session(f"t{secrets.token_hex(4)}").with_token()
    spec = RingSpec((), packet_dtype(MAX_BYTES), SLOTS)
    rings = [ring.create(session.segment(f"packets.{number}"), spec) for number in (1, 2)]
    output, taken = PacketOutput(session, "packets"), PacketInput(session, "packets.1")
    yield session, output, taken
    output.close()
    taken.close()
    for memory in rings:
        memory.close()
        memory.unlink()


FIRST = SessionOptions(packets="packets.1")


@settings(max_examples=MANY)
@given(
    st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 2)), max_size=30),
    st.integers(1, SLOTS - 2),
)
def test_packet_input_gives_each_frame_its_own_packet(
    kinds: list[tuple[str, int]], ahead: int
) -> None:
    """ahead: frames that capture is before the recorder. New epochs begin anywhere and count frames
    from anywhere.
    """
    epoch = 0
    waiting = list[tuple[Stamp, bytes | None]]()

    def take(taken: PacketInput) -> None:
        wanted, packet = waiting.pop(0)
        assert taken.of(wanted) == packet
        assert taken.of(wanted) == packet, "and again, when it is asked for again"

    with ends() as (_, output, taken):
        output.set_options(FIRST)
        for seq, (kind, new_epoch) in enumerate(kinds):
            epoch += new_epoch == 2
            size = MAX_BYTES + 1 if kind == "too large" else MAX_BYTES if seq % 2 else 7
            packet = None if kind == "no packet" else data(seq, size)
            output.publish(packet, seq, seq * 10, seq * 10, epoch)
            if kind != "frame not asked for":
                kept = packet.tobytes() if packet is not None and kind == "both" else None
                waiting.append((stamp(seq, epoch), kept))
            # further behind, what it wants would be gone
            while waiting and seq - waiting[0][0].source_seq >= ahead:
                take(taken)
        while waiting:
            take(taken)


def test_packet_input_lacks_only_what_was_overwritten() -> None:
    with ends() as (_, output, taken):
        output.set_options(FIRST)
        for seq in range(10):
            output.publish(data(seq), seq, 0, 0, 0)
        assert taken.of(stamp(1)) is None
        oldest = 10 - (SLOTS - 2) - 1
        assert [taken.of(stamp(seq)) for seq in range(oldest, 10)] == [
            data(seq).tobytes() for seq in range(oldest, 10)
        ]


def test_packet_output_goes_where_the_options_say() -> None:
    with ends() as (session, output, taken):
        output.publish(data(1), 1, 0, 0, 0)  # nobody records
        output.set_options(SessionOptions())
        output.set_options(SessionOptions(packets="packets.9"))  # taken back before it was used
        output.publish(data(1), 1, 0, 0, 0)
        output.set_options(FIRST)
        output.set_options(FIRST)
        output.publish(data(2), 2, 0, 0, 0)
        assert taken.of(stamp(1)) is None and taken.of(stamp(2)) == data(2).tobytes()
        second = PacketInput(session, "packets.2")
        output.set_options(SessionOptions(packets="packets.2"))
        output.publish(data(3), 3, 0, 0, 0)
        assert taken.of(stamp(3)) is None and second.of(stamp(3)) == data(3).tobytes()
        output.set_options(SessionOptions())
        output.publish(data(4), 4, 0, 0, 0)
        assert second.of(stamp(4)) is None
        second.close()
