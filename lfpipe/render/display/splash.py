"""A window with a title, until that of a session is there, or its parent has ended:

python -m lfpipe.render.display.splash SESSION TITLE window|fullscreen
"""

import contextlib
import sys
import threading
import time

from lfpipe.render.display import BACK, SECOND, TEXT
from lfpipe.render.display.window_system import icon, pygame, start, written
from lfpipe.transport.control import Session
from lfpipe.transport.status import State, Table


def shows(session: Session) -> bool:
    """Whether the session's own window is there."""
    with contextlib.suppress(OSError, ValueError):
        return bool(Table(session.segment("status")).rows["render"]["state"] == State.RUNNING)
    return False


def main(name: str, title: str, display: str) -> None:
    start()
    pygame.font.init()
    is_full = display == "fullscreen"
    window_px = pygame.display.get_desktop_sizes()[0] if is_full else (640, 360)
    window = pygame.Window(title, window_px, fullscreen_desktop=is_full)
    window.set_icon(icon())
    pygame.mouse.set_visible(not is_full)
    surface = window.get_surface()
    surface.fill(BACK)
    middle, unit_px = surface.get_rect().center, surface.get_height() // 15
    for text, y, size_px, colour in ((title, -1, 2, TEXT), ("Opening ...", 2, 1, SECOND)):
        words = written(text, size_px * unit_px, colour, size_px > 1)
        surface.blit(words, words.get_rect(center=(middle[0], middle[1] + y * unit_px)))
    session = Session(name)
    parent = threading.Thread(target=sys.stdin.read, daemon=True)  # it ends with the parent
    parent.start()
    while parent.is_alive() and not shows(session):
        if pygame.QUIT in (event.type for event in pygame.event.get()):
            break
        window.flip()
        time.sleep(0.05)


if __name__ == "__main__":
    main(*sys.argv[1:])
