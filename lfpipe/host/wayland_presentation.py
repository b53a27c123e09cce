"""Times at which a Wayland compositor showed a picture, through the client library that the window
uses.

wp_presentation reports the vertical blank. Some compositors offer it but never answer (wlroots 0.15
without a screen). Until the first answer, or if none comes, the frame callback stands in; it
reports the repaint that used the picture, in whole ms. Events arrive on a separate queue, so the
window library's events stay untouched. Interfaces and opcodes are those of wayland.xml and
presentation-time.xml.
"""

import ctypes
import time
from collections.abc import Callable
from typing import Any

from lfpipe.host.presentation import Presented

# numbers of requests
_PRESENTATION_FEEDBACK, _DISPLAY_GET_REGISTRY, _REGISTRY_BIND, _SURFACE_FRAME = 1, 1, 0, 3
_CLOCK_MONOTONIC = 1
_MAX_WAITING = 64  # answers outstanding; a hidden window gets none
_UNANSWERED = 30  # after this many frame callbacks without feedback none is expected

_Pointer, _Int = ctypes.c_void_p, ctypes.c_uint32


class _Message(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_char_p),
        ("signature", ctypes.c_char_p),
        ("types", ctypes.POINTER(_Pointer)),
    )


class _Interface(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_char_p),
        ("version", ctypes.c_int),
        ("method_count", ctypes.c_int),
        ("methods", ctypes.POINTER(_Message)),
        ("event_count", ctypes.c_int),
        ("events", ctypes.POINTER(_Message)),
    )


class _Argument(ctypes.Union):
    _fields_ = (("u", _Int), ("s", ctypes.c_char_p), ("o", _Pointer))


def _interface(
    name: bytes, methods: list[tuple[bytes, bytes]], events: list[tuple[bytes, bytes]]
) -> _Interface:
    """Types of arguments are null: libwayland would use them only to check this module's own
    objects.
    """
    untyped = (_Pointer * 8)()
    lists = [
        (_Message * len(kind))(*(_Message(*names, untyped) for names in kind))
        for kind in (methods, events)
    ]
    return _Interface(name, 1, len(methods), lists[0], len(events), lists[1])


_FEEDBACK = _interface(
    b"wp_presentation_feedback",
    [],
    [(b"sync_output", b"o"), (b"presented", b"uuuuuuu"), (b"discarded", b"")],
)
_PRESENTATION = _interface(
    b"wp_presentation", [(b"destroy", b""), (b"feedback", b"on")], [(b"clock_id", b"u")]
)
_PRESENTATION.methods[1].types[1] = ctypes.addressof(_FEEDBACK)

_ON_GLOBAL = ctypes.CFUNCTYPE(None, _Pointer, _Pointer, _Int, ctypes.c_char_p, _Int)
_ON_OBJECT = ctypes.CFUNCTYPE(None, _Pointer, _Pointer, _Pointer)
_ON_NUMBER = ctypes.CFUNCTYPE(None, _Pointer, _Pointer, _Int)
_ON_PRESENTED = ctypes.CFUNCTYPE(None, _Pointer, _Pointer, *[_Int] * 7)
_ON_DISCARDED = ctypes.CFUNCTYPE(None, _Pointer, _Pointer)


def _library() -> ctypes.CDLL:
    library = ctypes.CDLL("libwayland-client.so.0")
    for name in (
        "wl_display_create_queue",
        "wl_proxy_create_wrapper",
        "wl_proxy_marshal_array_flags",
    ):
        getattr(library, name).restype = _Pointer
    library.wl_display_create_queue.argtypes = [_Pointer]
    library.wl_proxy_create_wrapper.argtypes = [_Pointer]
    library.wl_proxy_wrapper_destroy.argtypes = [_Pointer]
    library.wl_proxy_set_queue.argtypes = [_Pointer, _Pointer]
    library.wl_proxy_marshal_array_flags.argtypes = [
        _Pointer,
        _Int,
        _Pointer,
        _Int,
        _Int,
        ctypes.POINTER(_Argument),
    ]
    library.wl_proxy_add_listener.argtypes = [_Pointer, _Pointer, _Pointer]
    library.wl_proxy_destroy.argtypes = [_Pointer]
    library.wl_display_roundtrip_queue.argtypes = [_Pointer, _Pointer]
    library.wl_display_dispatch_queue_pending.argtypes = [_Pointer, _Pointer]
    library.wl_event_queue_destroy.argtypes = [_Pointer]
    return library


class WaylandPresentation:
    """Feedback for one surface. display, surface: addresses of its wl_display and wl_surface.

    Raises OSError if the library is missing or too old.
    """

    def __init__(self, display: int, surface: int) -> None:
        self._display, self._surface = display, surface
        self._presentation = 0
        self._clock = -1
        self._feedback: list[Presented] = []
        self._waiting: dict[int, int] = {}  # address of a feedback -> serial
        self._frames: dict[int, int] = {}  # address of a frame callback -> serial
        self._done: list[tuple[int, int]] = []  # (stamp, serial) of frame callbacks
        self._answered = self._unanswered = 0
        self._listeners: list[Any] = []
        try:
            self._library = _library()
        except AttributeError as error:
            raise OSError(f"libwayland-client is too old: {error}") from None
        self._queue = self._library.wl_display_create_queue(display)
        wrapper = self._library.wl_proxy_create_wrapper(display)
        self._library.wl_proxy_set_queue(wrapper, self._queue)
        registry_interface = ctypes.addressof(
            _Pointer.in_dll(self._library, "wl_registry_interface")
        )
        self._registry = self._request(
            wrapper, _DISPLAY_GET_REGISTRY, registry_interface, [_Argument()]
        )
        self._library.wl_proxy_wrapper_destroy(wrapper)
        self._listen(self._registry, [_ON_GLOBAL(self._on_global), _ON_NUMBER(lambda *_: None)])
        self._library.wl_display_roundtrip_queue(display, self._queue)  # the globals
        if self._presentation:
            self._library.wl_display_roundtrip_queue(display, self._queue)  # the clock
        # a new object joins the queue of its creator
        self._framer = self._library.wl_proxy_create_wrapper(surface)
        self._library.wl_proxy_set_queue(self._framer, self._queue)
        self._callback_interface = ctypes.addressof(
            _Pointer.in_dll(self._library, "wl_callback_interface")
        )
        self._frame_listener = self._table([_ON_NUMBER(self._on_frame)])
        self._feedback_listener = self._table(
            [
                _ON_OBJECT(lambda *_: None),
                _ON_PRESENTED(self._on_presented),
                _ON_DISCARDED(self._on_discarded),
            ]
        )

    @property
    def name(self) -> str:
        """The one of the two protocols that reports now."""
        return "wp_presentation" if self._answered else "wl_surface.frame"

    def _request(self, proxy: int, opcode: int, interface: int, arguments: list[_Argument]) -> int:
        listed = (_Argument * len(arguments))(*arguments)
        new_proxy = self._library.wl_proxy_marshal_array_flags(
            proxy, opcode, interface, 1, 0, listed
        )
        if not new_proxy:
            raise OSError("the connection to the compositor has ended")
        return int(new_proxy)

    def _table(self, callbacks: list[Any]) -> Any:
        self._listeners.append(callbacks)  # keep them alive, the caller does not
        table = (_Pointer * len(callbacks))(
            *(ctypes.cast(callback, _Pointer) for callback in callbacks)
        )
        self._listeners.append(table)
        return table

    def _listen(self, proxy: int, callbacks: list[Callable[..., None]]) -> None:
        self._library.wl_proxy_add_listener(proxy, self._table(callbacks), None)

    def _on_global(
        self, _data: int, registry: int, name: int, interface: bytes, _version: int
    ) -> None:
        if interface != b"wp_presentation" or self._presentation:
            return
        arguments = [_Argument(u=name), _Argument(s=interface), _Argument(u=1), _Argument()]
        self._presentation = self._request(
            registry, _REGISTRY_BIND, ctypes.addressof(_PRESENTATION), arguments
        )
        self._listen(self._presentation, [_ON_NUMBER(self._on_clock)])

    def _on_clock(self, _data: int, _proxy: int, clock: int) -> None:
        self._clock = clock

    def _on_presented(
        self,
        _data: int,
        proxy: int,
        high_s: int,
        low_s: int,
        ns: int,
        refresh_ns: int,
        _high: int,
        _low: int,
        _flags: int,
    ) -> None:
        t_ns = ((high_s << 32) + low_s) * 1_000_000_000 + ns
        self._answered += 1
        self._feedback.append(Presented(self._waiting.pop(proxy), t_ns, refresh_ns))
        self._library.wl_proxy_destroy(proxy)

    def _on_discarded(self, _data: int, proxy: int) -> None:
        serial = self._waiting.pop(proxy)
        if self._answered:
            self._feedback.append(Presented(serial, 0, 0))
        self._library.wl_proxy_destroy(proxy)

    def _on_frame(self, _data: int, proxy: int, t_ms: int) -> None:
        now = time.monotonic_ns()
        ago_ms = (now // 1_000_000 - t_ms) % (1 << 32)
        # a stamp further from now comes from another clock
        t_ns = now - ago_ms * 1_000_000 if ago_ms < 1000 else now
        self._done.append((t_ns // 1_000_000 * 1_000_000 + 500_000, self._frames.pop(proxy)))
        self._unanswered += 1
        self._library.wl_proxy_destroy(proxy)

    def _repaints(self) -> list[Presented]:
        """Reports repaints; of the pictures used by one repaint, only the last was shown."""
        done = sorted(self._done)
        self._done = []
        last = {t_ns: serial for t_ns, serial in done}
        return [Presented(serial, t_ns if last[t_ns] == serial else 0, 0) for t_ns, serial in done]

    def expect(self, serial: int) -> None:
        """Announces picture number serial as the next to be submitted."""
        if not self._answered and len(self._frames) < _MAX_WAITING:
            frame = self._request(
                self._framer, _SURFACE_FRAME, self._callback_interface, [_Argument()]
            )
            self._frames[frame] = serial
            self._library.wl_proxy_add_listener(frame, self._frame_listener, None)
        expected = self._clock == _CLOCK_MONOTONIC and (
            self._answered or self._unanswered < _UNANSWERED
        )
        if expected and len(self._waiting) < _MAX_WAITING:
            arguments = [_Argument(o=self._surface), _Argument()]
            feedback = self._request(
                self._presentation, _PRESENTATION_FEEDBACK, ctypes.addressof(_FEEDBACK), arguments
            )
            self._waiting[feedback] = serial
            self._library.wl_proxy_add_listener(feedback, self._feedback_listener, None)

    def handed_over(self, serial: int) -> None:
        """Does nothing: both requests apply to the picture that follows them."""

    def take(self) -> list[Presented]:
        """The reports since the last call. The window's own event loop reads the connection."""
        self._library.wl_display_dispatch_queue_pending(self._display, self._queue)
        feedback = self._feedback
        self._feedback = []
        repaints = self._repaints()
        return feedback if self._answered else repaints

    def close(self) -> None:
        """Call before the window closes."""
        for proxy in (*self._waiting, *self._frames, self._presentation, self._registry):
            if proxy:
                self._library.wl_proxy_destroy(proxy)
        self._library.wl_proxy_wrapper_destroy(self._framer)
        self._waiting.clear()
        self._frames.clear()
        self._presentation = self._registry = 0
        self._library.wl_event_queue_destroy(self._queue)
