"""A window with the program's name, until that of a session is there, or its parent has ended:

python -m lfpipe.render.display.splash SESSION
"""

import contextlib
import sys
import threading
import time

from lfpipe.render.display.window_system import icon, pygame, start, written
from lfpipe.transport.control import Session
from lfpipe.transport.status import State, Table

SIZE_PX = 640, 360
BACK, TEXT, SECOND = (18, 21, 26), (255, 255, 255), (180, 190, 201)
WAIT_S = 0.05


def shows(session: Session) -> bool:
    """Whether the session's own window is there."""
    with contextlib.suppress(OSError, ValueError):
        return bool(Table(session.segment("status")).rows["render"]["state"] == State.RUNNING)
    return False


def main(name: str) -> None:
    start()
    pygame.font.init()
    window = pygame.Window("lfpipe", SIZE_PX)
    window.set_icon(icon())
    surface = window.get_surface()
    surface.fill(BACK)
    middle = SIZE_PX[0] // 2
    for text, y, size_px, colour in (("lfpipe", 140, 48, TEXT), ("Opening ...", 210, 24, SECOND)):
        words = written(text, size_px, colour, size_px > 24)
        surface.blit(words, words.get_rect(center=(middle, y)))
    session = Session(name)
    parent = threading.Thread(target=sys.stdin.read, daemon=True)  # it ends with the parent
    parent.start()
    while parent.is_alive() and not shows(session):
        if pygame.QUIT in (event.type for event in pygame.event.get()):
            break
        window.flip()
        time.sleep(WAIT_S)


if __name__ == "__main__":
    main(sys.argv[1])
