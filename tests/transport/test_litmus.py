"""The ring on a machine that reorders memory accesses: nothing is torn, and (tests/faults.toml) no
fence can be left out. Every execution is tried, with the accesses that the code itself makes.

The real `Writer` and `Reader` run on arrays that record each load, store and fence. The model then
lets each thread make its accesses in every order that its fences allow: two accesses stay in order
only if a fence stands between them or they are of one place. Memory itself is shared by all at once
(multi-copy atomic), as on ARMv8, RISC-V and x86. Dependencies order nothing, so the model is weaker
than any of these machines. The values that an execution loads are given to the real reader, which
takes or refuses them.
"""

from collections.abc import Callable, Iterator
from typing import Any, Literal, TypeVar

import attrs
import numpy as np
import pytest

from lfpipe.transport import ring
from lfpipe.transport.ring import Reader, Stamp, Writer

SLOTS, PUBLISHED = 3, 5  # the least number of slots; so many are published meanwhile
Way = Literal["read", "read_next", "peek"]
WAYS: tuple[Way, ...] = ("read", "read_next", "peek")
Place = tuple[str, int]  # what, of which slot


@attrs.frozen
class Access:
    """place: None for a fence. value: None for a load."""

    place: Place | None
    value: int | None = None


T = TypeVar("T")


class _NoMoreValues(Exception):
    """The reader starts again: it has refused the values that it got."""


class _Trace:
    """What a thread does, in the order of its program. loads: the values that it gets, in turn."""

    def __init__(self, loads: tuple[int, ...] = ()) -> None:
        self.accesses: list[Access] = []
        self._loads = iter(loads)

    def fence(self) -> None:
        self.accesses.append(Access(None))

    def load(self, place: Place) -> int:
        self.accesses.append(Access(place))
        try:
            return next(self._loads)
        except StopIteration:
            raise _NoMoreValues from None

    def store(self, place: Place, value: int) -> None:
        self.accesses.append(Access(place, int(value)))


class _Counter:
    """The counter `published`. own: what its one writer, which alone changes it, reads of it."""

    def __init__(self, trace: _Trace, own: bool) -> None:
        self._trace = trace
        self._own = own
        self._value = 0

    def __getitem__(self, _: int) -> int:
        return self._value if self._own else self._trace.load(("published", 0))

    def __setitem__(self, _: int, value: int) -> None:
        self._value = value
        self._trace.store(("published", 0), value)


class _Head:
    """A slot's header: seq, and source_seq for all of its stamps."""

    def __init__(self, trace: _Trace, slot: int) -> None:
        self._trace, self._slot = trace, slot

    def __setitem__(self, key: Any, value: Any) -> None:
        if isinstance(key, slice):
            self._trace.store(("stamp", self._slot), value[0])
        else:
            self._trace.store(("seq", self._slot), value)

    def __getitem__(self, key: Any) -> Any:
        return np.array(
            [
                self._trace.load(("seq", self._slot)),
                self._trace.load(("stamp", self._slot)),
                0,
                0,
                0,
                0,
                0,
            ]
        )


class _Payload:
    """A slot's payload of two words."""

    def __init__(self, trace: _Trace, slot: int) -> None:
        self._trace, self._slot = trace, slot

    def fill(self, value: int) -> None:
        for word in ("low", "high"):
            self._trace.store((word, self._slot), value)

    def __array__(self, *_: Any, **__: Any) -> Any:
        return np.array([self._trace.load((word, self._slot)) for word in ("low", "high")])


def _on(trace: _Trace, kind: type[Any], own: bool) -> Any:
    """A writer or reader whose memory is trace."""
    made: Any = object.__new__(kind)
    made.slots = SLOTS
    made.shape = (2,)
    made.dtype = np.dtype("i8")
    made._published = _Counter(trace, own)
    made._epoch = [0]
    made._heads = [_Head(trace, slot) for slot in range(SLOTS)]
    made._payloads = [_Payload(trace, slot) for slot in range(SLOTS)]
    return made


def _traced(trace: _Trace, act: Callable[[], T]) -> T:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ring, "fence", trace.fence)
        return act()


def writer_program() -> list[Access]:
    trace = _Trace()
    writer = _on(trace, Writer, own=True)

    def act() -> None:
        for number in range(1, PUBLISHED + 1):
            writer.begin().fill(number)
            writer.publish(number, 0, 0)

    _traced(trace, act)
    return trace.accesses


def _take(trace: _Trace, way: Way, last_seq: int) -> tuple[Stamp, Any] | None:
    """What the real reader makes of the values in trace; None where it refuses them."""
    reader: Reader = _on(trace, Reader, own=False)
    reader.last_seq = last_seq
    out = np.zeros(2, np.int64)

    def act() -> tuple[Stamp, Any] | None:
        try:
            if way != "peek":
                stamp = reader.read(out) if way == "read" else reader.read_next(out)
                return (stamp, out) if stamp else None
            found = reader.peek()
            if found is None:
                return None
            taken = np.asarray(found[1])
            return (found[0], taken) if reader.still_valid(found[0]) else None
        except _NoMoreValues:
            return None

    return _traced(trace, act)


def reader_program(way: Way, last_seq: int, p: int) -> tuple[list[Access], int]:
    """The accesses of a read that finds p published, and the number of the slot that it takes."""
    number = max(last_seq + 1, p - SLOTS + 2) if way == "read_next" else p
    loads = {"peek": (p, number, number, p, number, number, p)}.get(
        way, (p, number, number, number, number, p)
    )
    trace = _Trace(loads)
    assert _take(trace, way, last_seq) is not None, "nothing in the way of this read"
    return trace.accesses, number


def _before(program: list[Access]) -> tuple[list[Access], list[int]]:
    """Loads and stores of a program, and for each the set, as bits, of those that must come before
    it.
    """
    accesses = list[Access]()
    needed = list[int]()
    fenced = 0
    since = 0
    for access in program:
        if access.place is None:
            fenced |= since
            continue
        same = sum(1 << i for i, other in enumerate(accesses) if other.place == access.place)
        needed.append(fenced | same)
        since |= 1 << len(accesses)
        accesses.append(access)
    return accesses, needed


def executions(writer: list[Access], reader: list[Access], p: int) -> Iterator[tuple[int, ...]]:
    """The values of all loads of the reader, in the order of its program, for every execution in
    which it finds p first.
    """
    stores, store_after = _before(writer)
    loads, load_after = _before(reader)
    memory: tuple[tuple[Place, int], ...] = ()
    found: tuple[tuple[int, int], ...] = ()
    todo = [(0, 0, memory, found)]
    seen = set(todo)
    while todo:
        written, read, memory, found = todo.pop()
        if read == (1 << len(loads)) - 1:
            yield tuple(value for _, value in sorted(found))
            continue
        held = dict(memory)
        following = []
        for i, store in enumerate(stores):
            if not written >> i & 1 and store_after[i] & ~written == 0:
                now = tuple(sorted((held | {store.place: store.value}).items()))
                following.append((written | 1 << i, read, now, found))
        for i, load in enumerate(loads):
            if not read >> i & 1 and load_after[i] & ~read == 0:
                value = held.get(load.place, 0)  # type: ignore[arg-type]
                if i or value == p:
                    following.append((written, read | 1 << i, memory, (*found, (i, value))))
        for state in following:
            key = (state[0], state[1], state[2], tuple(sorted(state[3])))
            if key not in seen:
                seen.add(key)  # type: ignore[arg-type]
                todo.append(key)  # type: ignore[arg-type]


def verdict() -> str:
    """ "whole", or the first fault found: "torn" or "refused in vain"."""
    writer = writer_program()
    for way in WAYS:
        for p in range(1, PUBLISHED + 1):
            for last_seq in {p - 1, max(0, p - SLOTS)} if way == "read_next" else {p - 1}:
                reader, number = reader_program(way, last_seq, p)
                for values in set(executions(writer, reader, p)):
                    taken = _take(_Trace(values), way, last_seq)
                    if taken is None and values[-1] == number:  # nothing was published meanwhile
                        return f"refused in vain: {way}, {values}"
                    if taken is not None and {
                        *taken[1].tolist(),
                        taken[0].source_seq,
                        taken[0].seq,
                    } != {number}:
                        return f"torn: {way}, {values}"
    return "whole"


def test_ring_gives_whole_slots_in_every_execution() -> None:
    assert verdict() == "whole"
