"""The window on the screen: pictures through a painter, zoomed by the wheel and panned by a drag,
the overlay, keys and clicks as events, and the times of display.
"""

import contextlib
import math
import time
from collections import deque

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.codecs import fit_area
from lfpipe.host.presentation import Presented
from lfpipe.render.display.display import PICTURE_MM, Display, Event, Overlay
from lfpipe.render.display.overlay_view import OverlayView
from lfpipe.render.display.painters import open_painter
from lfpipe.render.display.window_system import (
    connection_fds,
    drawable,
    find_monitor,
    icon,
    monitor_number,
    monitors,
    new_events,
    open_presentation,
    pygame,
    start,
)
from lfpipe.render.synthesis.anaglyph import Pair, arrange_stereo_pair

STEP = 1.2  # of the factor for a step of the wheel: four double it
MOST = 8.0  # a pixel of the scene is then as large as a letter
Share = tuple[float, float]


@attrs.define
class Zoom:
    """A factor, and the place in the middle as shares of the picture's width and height."""

    factor: float = 1.0
    x: float = 0.5
    y: float = 0.5

    def turn(self, steps: int, at: Share) -> None:
        """Zooms in by steps of the wheel, or out; the place under the pointer stays.

        at: the pointer, as fractions of the visible part.
        """
        before = self.factor
        self.factor = min(max(before * STEP**steps, 1.0), MOST)
        change = 1 / before - 1 / self.factor
        self._move(self.x + (at[0] - 0.5) * change, self.y + (at[1] - 0.5) * change)

    def drag(self, by: Share) -> None:
        """Moves the picture with the pointer. by: fractions of the visible part."""
        self._move(self.x - by[0] / self.factor, self.y - by[1] / self.factor)

    def _move(self, x: float, y: float) -> None:
        half = 0.5 / self.factor
        self.x, self.y = (min(max(at, half), 1 - half) for at in (x, y))

    def part(self, rows: int, cols: int) -> tuple[slice, slice]:
        """The part of a picture of that size."""
        high, wide = max(1, round(rows / self.factor)), max(1, round(cols / self.factor))
        top = min(max(round(self.y * rows - high / 2), 0), rows - high)
        left = min(max(round(self.x * cols - wide / 2), 0), cols - wide)
        return slice(top, top + high), slice(left, left + wide)


# least height of a line of text: its letters have 15 px; and its share of the monitor's height: 17
# px on one of 1080 rows, as elsewhere on a desktop
TEXT_PX = 20
TEXT_SHARE = 23 / 1080
DOUBLE_S, DOUBLE_PX = 0.4, 8  # between two presses of a double click, as on most desktops
MOUSE = (pygame.MOUSEMOTION, pygame.MOUSEBUTTONDOWN, pygame.MOUSEBUTTONUP, pygame.MOUSEWHEEL)
RESIZED = (pygame.WINDOWSIZECHANGED, pygame.WINDOWDISPLAYCHANGED)
# a move may swap the screen rows of the two views
REDRAWN = (pygame.WINDOWEXPOSED, pygame.WINDOWMOVED, *RESIZED)
NAMES = {
    pygame.K_F11: "f11",
    pygame.K_ESCAPE: "escape",
    pygame.K_TAB: "tab",
    pygame.K_LEFT: "left",
    pygame.K_RIGHT: "right",
    pygame.K_UP: "up",
    pygame.K_DOWN: "down",
    pygame.K_PAGEDOWN: "pagedown",
    pygame.K_PAGEUP: "pageup",
    pygame.K_RETURN: "enter",
    pygame.K_KP_ENTER: "enter",
}


def letters_px(monitor_px: int) -> float:
    """The height of a line of text on a monitor of that height."""
    return max(TEXT_PX, TEXT_SHARE * monitor_px)


class ScreenWindow(Display):
    """A resizable or full-screen window. `show` submits a picture at once; `presented` reports
    when the screen showed it.

    Its pixels are the screen's own: SDL asks a desktop that scales windows not to scale this one.
    monitor: the one that the window is on.
    """

    def __init__(
        self,
        size_px: tuple[int, int],
        title: str,
        fullscreen: bool = False,
        monitor: str = "",
        code: str = "",
    ) -> None:
        """size_px: (width, height) of the pictures. monitor: a number or name, as for
        `find_monitor`; empty: the desktop chooses. code: only these letters have an effect, and
        quit; other keys, buttons and drops have none. Raises UserError if no window can be opened,
        or the monitor is missing.
        """
        self._code = code
        self._natives: deque[pygame.Event] = deque()  # not handled yet
        self._typed = ""
        self._title = title
        self._fullscreen = fullscreen
        self._asked_monitor = monitor
        # the arguments of the last call of `show`
        self._shown: tuple[NDArray[np.uint8], Pair | None, str] | None = None
        self._laid: NDArray[np.uint8] | None = None
        self._view = OverlayView()
        self._zoom = Zoom()
        self._is_new = False  # the scene
        self._pans = False  # a drag with the left button
        self._pressed = -math.inf, (0, 0)  # time and place of the last press of the left button
        # of the picture, and of the submission: a picture may be drawn again
        self._number = self._handed = 0
        self._numbers: dict[int, int] = {}  # submission -> picture
        try:
            self._driver = start()
            self.monitor = find_monitor(monitor, monitors()) if monitor else monitors()[0]
            self._windowed = self.monitor.window_for(size_px)
            self._area_px = math.prod(self._windowed)
            centre = pygame.WINDOWPOS_CENTERED | self.monitor.number
            self._at = (centre if monitor else pygame.WINDOWPOS_UNDEFINED,) * 2
            pygame.font.init()
            self._open()
        except pygame.error as error:
            raise UserError(
                f"no window can be opened: {error}", "use --display none or --display file:OUT.mkv"
            ) from None
        self._shown_px = fit_area(size_px, self._painter.size_px())[2]

    def _open(self) -> None:
        whole, monitor = self._fullscreen, self.monitor
        self._window = pygame.Window(
            self._title,
            (monitor.width, monitor.height) if whole else self._windowed,
            (monitor.x, monitor.y) if whole else self._at,
            fullscreen_desktop=whole,
            resizable=not whole,
            allow_high_dpi=True,
        )
        self._window.set_icon(icon())
        self._painter = open_painter(self._window, self._driver)
        if not whole and pygame.WINDOWPOS_UNDEFINED not in self._at:
            # else a window manager places the frame there, and the picture below its title
            self._window.position = self._at
        self._presentation = open_presentation(self._window)
        self.vblank_source = self._presentation.name if self._presentation is not None else ""
        self.fds = connection_fds(self._window)
        # Wayland hides the position of a window
        self.knows_rows = whole or self._driver != "wayland"
        self._numbers.clear()

    def _close(self) -> None:
        if self._presentation is not None:
            self._presentation.close()
        self._window.destroy()

    def presented(self) -> list[Presented]:
        answers: list[Presented] = []
        for answer in self._presentation.reports() if self._presentation is not None else []:
            number = self._numbers.pop(answer.serial, None)
            # else it was drawn again
            if number is not None and (answer.t_ns or number not in self._numbers.values()):
                answers.append(Presented(number, answer.t_ns, answer.period_ns))
        return answers

    def _toggle(self) -> None:
        """Switches to full screen on the chosen monitor, or else on the window's; or back to the
        window's old position.

        Opens the window again: without a window manager SDL neither moves nor shrinks an open one.
        """
        if not self._fullscreen:
            self._windowed, self._at = self._window.size, self._window.position
        self._find_monitor()
        if self._asked_monitor:
            with contextlib.suppress(UserError):  # the chosen one was unplugged
                self.monitor = find_monitor(self._asked_monitor, monitors())
        self._fullscreen = not self._fullscreen
        self._close()
        self._open()

    def _find_monitor(self) -> None:
        """The monitor that the window is on now; others may have been plugged or unplugged."""
        offered = monitors()
        number = monitor_number(self._window)
        self.monitor = next(
            (monitor for monitor in offered if monitor.number == number),
            (*offered, self.monitor)[0],  # the same where all are gone
        )

    def shown_px(self, picture_px: tuple[int, int]) -> tuple[int, int]:
        return fit_area(picture_px, self._painter.size_px())[2:]

    def width_mm(self) -> float | None:
        shown_px = self._shown_px * self._zoom.factor
        if self.monitor.pixel_mm:
            return shown_px * self.monitor.pixel_mm
        width_px = self.monitor.width * self._painter.size_px()[0] / self._window.size[0]
        return shown_px / width_px * PICTURE_MM

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        """Returns the time at which the window system accepted the picture."""
        self._shown = picture, pair, how
        if self._is_new:
            self._fit_shape(picture.shape[1] / picture.shape[0])
        self._number += 1
        self._draw()
        return time.monotonic_ns()

    def _fit_shape(self, aspect: float) -> None:
        """Gives a window that nobody has resized the shape of another scene, and the same area."""
        self._is_new = False
        if not self._fullscreen and self._window.size == self._windowed:
            wide = math.sqrt(self._area_px * aspect)
            most = self.monitor.window_for((round(1000 * aspect), 1000))
            self._windowed = self._window.size = min(most, (round(wide), round(wide / aspect)))

    def _draw(self, again: bool = True) -> None:
        """Draws picture and overlay. again: also if neither has changed."""
        pygame.mouse.set_visible(not self._fullscreen or self._view.has_pointer)
        window_px = self._painter.size_px()
        text_px = round(letters_px(self.monitor.height) * (window_px[0] / self._window.size[0]))
        before, panels = self._view.drawn, self._view.panels(window_px, text_px)
        if self._shown is None or (panels == before and not again):
            return
        picture, pair, how = self._shown
        picture = picture[self._zoom.part(*picture.shape[:2])]
        self._shown_px = fit_area((picture.shape[1], picture.shape[0]), window_px)[2]
        if pair is not None:
            left, right = (view[self._zoom.part(*view.shape[:2])] for view in pair)
            # the row of the screen on which the window begins, negative above its top
            first_row = 0 if self._fullscreen else self._window.position[1] - self.monitor.y
            picture = self._laid = arrange_stereo_pair(
                (left, right), how, window_px, first_row, self._laid
            )
        self._handed += 1
        with self.waiting():
            self._painter.paint(picture, panels)
            self._painter.swap()
        if self._presentation is not None:
            self._numbers[self._handed] = self._number
            self._presentation.handed_over(self._handed)

    def overlay(self, overlay: Overlay) -> None:
        self._view.set(overlay)
        self._draw(again=False)

    def events(self) -> list[Event]:
        """The next event, or none: what a key means depends on what the one before it opened.

        Handles full screen itself, and redraws after it was covered or resized.
        """
        event, again = None, False
        self.pointer = attrs.evolve(self.pointer, wheel=0)
        zoom = attrs.evolve(self._zoom)
        with self.waiting():
            self._natives.extend(new_events())
        while self._natives and event is None:
            native = self._natives.popleft()
            if native.type in RESIZED:
                self._find_monitor()
            again |= native.type in REDRAWN
            event = self._event(native)
            if event == Event("leave-fullscreen"):  # Esc where it closes nothing
                event = Event("fullscreen") if self._fullscreen else None
        if event is not None and event.name == "fullscreen":
            self._toggle()
            again = True
        self._draw(again or self._zoom != zoom)
        return [] if event is None else [event]

    def _event(self, native: pygame.Event) -> Event | None:
        """What a person did."""
        if native.type in MOUSE:
            return self._mouse(native)
        if self._code:
            if native.type == pygame.KEYDOWN:
                self._typed = (self._typed + native.unicode)[-len(self._code) :]
            return Event("quit") if self._typed == self._code else None
        if native.type == pygame.QUIT:
            return Event("quit")
        if native.type == pygame.DROPFILE:
            return Event("load", native.file)
        if native.type == pygame.KEYDOWN:
            return self._view.key(NAMES.get(native.key) or native.unicode.lower())
        return None

    def _at_px(self) -> tuple[int, int]:
        """The pointer, in px of the window."""
        x_px, y_px = self._painter.size_px()
        return round(self.pointer.x * x_px), round(self.pointer.y * y_px)

    def _point(self, event: pygame.Event) -> None:
        """Moves the pointer. In a locked window any touch or button looks around, as elsewhere the
        right button does.
        """
        if event.type == pygame.MOUSEWHEEL:
            self.pointer = attrs.evolve(self.pointer, wheel=self.pointer.wheel + event.y)
        else:
            x, y = (
                min(max(at / size, 0.0), 1.0)
                for at, size in zip(event.pos, self._window.size, strict=True)
            )
            self.pointer = attrs.evolve(self.pointer, x=x, y=y)
            if event.type != pygame.MOUSEMOTION and event.button in (1, 3):
                name = "left" if event.button == 1 and not self._code else "right"
                pressed = {name: event.type == pygame.MOUSEBUTTONDOWN}
                self.pointer = attrs.evolve(self.pointer, **pressed)

    def _mouse(self, native: pygame.Event) -> Event | None:
        """Moves the pointer; what a click or a touch means: in a locked window, an entry of the
        overlay, or nothing.
        """
        before = self._at_shown()
        if native.type == pygame.MOUSEWHEEL and not (self.pointer.right or self._code):
            if self._view.mouse(native, self._at_px()) is None:
                self._zoom.turn(native.y, before)
            return None
        self._point(native)
        at_px = self._at_px()
        event = self._view.mouse(native, at_px)
        if native.type == pygame.MOUSEBUTTONUP:
            self._pans = False
        if event is not None and event.name:
            # a click, and no drag of the view; it does not look around
            self.pointer = attrs.evolve(
                self.pointer, left=False, right=self.pointer.right and not self._code
            )
        elif native.type == pygame.MOUSEBUTTONDOWN and native.button == 1 and not self._code:
            self._press(at_px)
        elif self._pans:
            after = self._at_shown()
            self._zoom.drag((after[0] - before[0], after[1] - before[1]))
        return event

    def _press(self, at_px: tuple[int, int]) -> None:
        """A press of the left button on the picture: perhaps a double click, or the start of a
        drag.
        """
        (before_s, before_px), self._pressed = self._pressed, (time.monotonic(), at_px)
        is_near = math.dist(at_px, before_px) < DOUBLE_PX
        if is_near and self._pressed[0] - before_s < DOUBLE_S:
            self._zoom = Zoom()
        self._pans = self._zoom.factor > 1.0
        if self._pans:
            self.pointer = attrs.evolve(self.pointer, left=False)

    def _at_shown(self) -> tuple[float, float]:
        """The pointer as fractions of the visible part of the picture; outside 0 to 1 beside it."""
        if self._shown is None:
            return self.pointer.x, self.pointer.y
        rows, cols = self._shown[0].shape[:2]
        size_px = self._painter.size_px()
        left, top, width, height = fit_area((cols, rows), size_px)
        return (
            (self.pointer.x * size_px[0] - left) / width,
            (self.pointer.y * size_px[1] - top) / height,
        )

    def title(self, name: str) -> None:
        self._title = self._window.title = f"lfpipe: {drawable(name)}"
        self._is_new = True

    def close(self) -> None:
        self._close()
        pygame.display.quit()
