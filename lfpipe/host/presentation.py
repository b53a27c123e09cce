"""Reports of an X server about a picture on its screen.

X's Present extension reports vertical blanks, over a separate connection. The first one after the
submission of a picture shows it, unless a compositor intervenes. It is identified by its time,
because servers without a screen count vblanks half a period off (present_fake.c).
"""

import ctypes
import time

import attrs

_GENERIC_EVENT, _COMPLETE_NOTIFY_MASK, _NOTIFY_MSC = 35, 2, 1  # Xproto.h, presenttokens.h
_MAX_WAITING = 64  # answers outstanding
_PERIOD_GAIN = 0.05  # of each new period in the average


@attrs.frozen
class Presented:
    """When a picture was shown."""

    serial: int
    """Number of the picture."""
    t_ns: int
    """The vertical blank that shows it (CLOCK_MONOTONIC); 0 if it was never shown."""
    period_ns: int
    """Of the screen; 0 if unknown."""


class _Complete(ctypes.Structure):
    """The head of xcb_present_complete_notify_event_t."""

    _pack_ = 1
    _fields_ = (
        ("response_type", ctypes.c_uint8),
        ("extension", ctypes.c_uint8),
        ("sequence", ctypes.c_uint16),
        ("length", ctypes.c_uint32),
        ("event_type", ctypes.c_uint16),
        ("kind", ctypes.c_uint8),
        ("mode", ctypes.c_uint8),
        ("event", ctypes.c_uint32),
        ("window", ctypes.c_uint32),
        ("serial", ctypes.c_uint32),
        ("ust", ctypes.c_uint64),
        ("full_sequence", ctypes.c_uint32),
        ("msc", ctypes.c_uint64),
    )


class _Extension(ctypes.Structure):
    """xcb_query_extension_reply_t up to the opcode."""

    _fields_ = (
        ("head", ctypes.c_uint32 * 2),
        ("present", ctypes.c_uint8),
        ("major_opcode", ctypes.c_uint8),
    )


class VblankAnswers:
    """The pictures that a server's answers, each naming a vertical blank, refer to."""

    def __init__(self) -> None:
        self._submitted_ns: dict[int, int] = {}  # serial -> submission, in this order
        self._answered: dict[int, Presented] = {}  # by serial: an earlier picture has no answer
        self._period_ns = 0.0
        self._pending: Presented | None = None
        self._last: tuple[int, int] | None = None  # (time, number) of a vblank

    @property
    def waiting(self) -> int:
        """Pictures without an answer."""
        return len(self._submitted_ns)

    def on_submission(self, serial: int, t_ns: int) -> None:
        """Picture number serial was submitted at t_ns."""
        self._submitted_ns[serial] = t_ns

    def on_answer(self, serial: int, t_ns: int, number: int) -> list[Presented]:
        """Vblank `number` at t_ns answers for a picture; returns the answers that are certain now.

        Of several pictures before one vertical blank the last was shown: an answer is held while
        another may follow for the same one.
        """
        if self._last and number > self._last[1]:
            period_ns = (t_ns - self._last[0]) / (number - self._last[1])
            self._period_ns += (period_ns - self._period_ns) * (
                _PERIOD_GAIN if self._period_ns else 1.0
            )
        self._last = t_ns, number
        after_ns = max(t_ns - self._submitted_ns[serial], 0)
        before = int(after_ns / self._period_ns) if self._period_ns else 0
        self._answered[serial] = Presented(
            serial, round(t_ns - before * self._period_ns), round(self._period_ns)
        )
        # present_fake.c delays an answer by a vertical blank if its timer fires early: then that of
        # the next picture comes first, and waits
        reports: list[Presented] = []
        while (first := next(iter(self._submitted_ns), -1)) in self._answered:
            del self._submitted_ns[first]
            new, last = self._answered.pop(first), self._pending
            if last and new.t_ns - last.t_ns <= self._period_ns / 2:
                new, last = attrs.evolve(new, t_ns=last.t_ns), Presented(last.serial, 0, 0)
            reports += [last] if last else []
            self._pending = new
        return reports

    def last_answer(self) -> list[Presented]:
        """The held answer, once no other can follow for its vertical blank."""
        if self._pending is None or self._submitted_ns:
            return []
        last, self._pending = self._pending, None
        return [last]


class XPresentation:
    """Vblanks for one window of the server that DISPLAY names.

    Raises OSError if the library or the extension is missing.
    """

    name = "x_present"

    def __init__(self, window: int) -> None:
        self._xcb, self._present = ctypes.CDLL("libxcb.so.1"), ctypes.CDLL("libxcb-present.so.0")
        self._free = ctypes.CDLL(None).free
        self._free.argtypes = [ctypes.c_void_p]
        self._xcb.xcb_connect.restype = ctypes.c_void_p
        self._xcb.xcb_get_extension_data.restype = ctypes.POINTER(_Extension)
        self._xcb.xcb_get_extension_data.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
        self._xcb.xcb_poll_for_event.restype = ctypes.c_void_p
        for name in (
            "xcb_poll_for_event",
            "xcb_flush",
            "xcb_disconnect",
            "xcb_connection_has_error",
            "xcb_generate_id",
        ):
            getattr(self._xcb, name).argtypes = [ctypes.c_void_p]
        self._present.xcb_present_select_input.argtypes = [ctypes.c_void_p, *[ctypes.c_uint32] * 3]
        self._present.xcb_present_notify_msc.argtypes = [
            ctypes.c_void_p,
            *[ctypes.c_uint32] * 2,
            *[ctypes.c_uint64] * 3,
        ]
        self._window = window
        self._answers = VblankAnswers()
        self._connection = self._xcb.xcb_connect(None, None)
        extension = None
        if not self._xcb.xcb_connection_has_error(self._connection):
            key = ctypes.addressof(ctypes.c_char.in_dll(self._present, "xcb_present_id"))
            extension = self._xcb.xcb_get_extension_data(self._connection, key)
        if not extension or not extension.contents.present:
            self._xcb.xcb_disconnect(self._connection)
            raise OSError("the X server has no Present extension")
        self._opcode = int(extension.contents.major_opcode)
        self._present.xcb_present_select_input(
            self._connection,
            self._xcb.xcb_generate_id(self._connection),
            window,
            _COMPLETE_NOTIFY_MASK,
        )
        self._xcb.xcb_flush(self._connection)

    def handed_over(self, serial: int) -> None:
        """Requests the next vertical blank."""
        if self._answers.waiting < _MAX_WAITING:
            number = serial & 0xFFFFFFFF
            self._answers.on_submission(number, time.monotonic_ns())
            self._present.xcb_present_notify_msc(self._connection, self._window, number, 0, 1, 0)
            self._xcb.xcb_flush(self._connection)

    def reports(self) -> list[Presented]:
        """What became known since the last call."""
        reports: list[Presented] = []
        while address := self._xcb.xcb_poll_for_event(self._connection):
            event = _Complete.from_address(address)
            if (
                event.response_type & 0x7F == _GENERIC_EVENT
                and event.extension == self._opcode
                and event.kind == _NOTIFY_MSC
            ):
                reports += self._answers.on_answer(event.serial, event.ust * 1000, event.msc)
            self._free(address)
        return reports + self._answers.last_answer()

    def close(self) -> None:
        """Ends the connection."""
        self._xcb.xcb_disconnect(self._connection)
