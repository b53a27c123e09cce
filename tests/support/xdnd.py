"""Drag and drop on X as a file manager does it (https://freedesktop.org/wiki/Specifications/XDND):
for tests.
"""

import ctypes
import re
import select
import subprocess
import time
from pathlib import Path

CLIENT_MESSAGE, SELECTION_REQUEST, SELECTION_NOTIFY = 33, 30, 31
NAMES = ("Enter", "Position", "Status", "Drop", "Finished", "Selection", "ActionCopy")
Event = ctypes.c_long * 24  # XEvent: type, serial, sent, display, window, then what the type has


def drop(path: Path, title: str, display: str, wait_s: float = 10.0) -> None:
    """Drops a file onto the middle of the window of that title."""
    found = subprocess.run(
        ["xwininfo", "-display", display, "-name", title],
        capture_output=True,
        text=True,
        check=True,
    )
    match = re.search(r"Window id: (0x[0-9a-f]+)", found.stdout)
    assert match is not None, found.stdout
    window = int(match[1], 16)
    x11 = ctypes.CDLL("libX11.so.6")
    for name in ("XOpenDisplay", "XDefaultRootWindow", "XCreateSimpleWindow", "XInternAtom"):
        getattr(x11, name).restype = ctypes.c_void_p
    there = ctypes.c_void_p(x11.XOpenDisplay(display.encode()))

    def atom(name: str) -> int:
        return int(x11.XInternAtom(there, name.encode(), 0))

    try:
        atoms = {name: atom(f"Xdnd{name}") for name in NAMES}
        uris = atom("text/uri-list")
        root = ctypes.c_void_p(x11.XDefaultRootWindow(there))
        source = x11.XCreateSimpleWindow(there, root, 0, 0, 1, 1, 0, 0, 0)
        x11.XSetSelectionOwner(there, ctypes.c_ulong(atoms["Selection"]), ctypes.c_ulong(source), 0)

        def send(kind: str, *data: int) -> None:
            event = Event(CLIENT_MESSAGE, 0, 1, 0, window, atoms[kind], 32, source, *data)
            x11.XSendEvent(there, ctypes.c_ulong(window), 0, 0, ctypes.byref(event))
            x11.XFlush(there)

        send("Enter", 5 << 24, uris)
        send("Position", 0, (600 << 16) | 400, 0, atoms["ActionCopy"])
        end = time.monotonic() + wait_s
        event = Event()
        while time.monotonic() < end:
            if not x11.XPending(there):
                left_s = max(0.0, end - time.monotonic())
                select.select([x11.XConnectionNumber(there)], (), (), left_s)
                continue
            x11.XNextEvent(there, ctypes.byref(event))
            kind = event[0] & 0xFFFFFFFF
            if kind == CLIENT_MESSAGE and event[5] == atoms["Status"]:
                assert event[8] & 1, "the window takes no drops"
                send("Drop", 0, 0)
            elif kind == CLIENT_MESSAGE and event[5] == atoms["Finished"]:
                return
            elif kind == SELECTION_REQUEST:
                _, _, _, _, _, requestor, selection, target, place, t = event[:10]
                data = f"{path.as_uri()}\r\n".encode()
                x11.XChangeProperty(
                    there, *map(ctypes.c_ulong, (requestor, place, target)), 8, 0, data, len(data)
                )
                answer = Event(SELECTION_NOTIFY, 0, 1, 0, requestor, selection, target, place, t)
                x11.XSendEvent(there, ctypes.c_ulong(requestor), 0, 0, ctypes.byref(answer))
                x11.XFlush(there)
        raise AssertionError("the drop was not finished")
    finally:
        x11.XCloseDisplay(there)
