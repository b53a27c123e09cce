"""The window on the screen: pictures through a painter, keys, text over the picture, and the times of display."""

import contextlib
import time
from collections.abc import Callable

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_area
from lfpipe.host.presentation import Presentation, Presented
from lfpipe.render import window_system
from lfpipe.render.bar import SHOWN_S, Bar
from lfpipe.render.display import KEYS, BarState, DisplayNotice, Pointer
from lfpipe.render.monitors import Monitor, find_monitor, monitor_of, monitors
from lfpipe.render.painters import Painter, Panels, open_painter, panel
from lfpipe.render.pair_layout import Pair, laid_out
from lfpipe.render.window_system import KeyLock, nominal_hz, open_presentation, pygame

SMALLEST_PX, SMALLEST_SHARE = 640, 1 / 3  # of the monitor's width; the first window enlarges small light fields
MOUSE = (pygame.MOUSEMOTION, pygame.MOUSEBUTTONDOWN, pygame.MOUSEBUTTONUP, pygame.MOUSEWHEEL)
USUAL_MM = 531.0  # width of a 24-inch screen of 16:9, for monitors that report no size
HINT_S = 6.0
SCREEN_SHARE, MENU_SHARE = 0.85, 0.9  # of the monitor, at most, for a window; of the window for a menu
PROGRESS_PX = 3
TEXT_PX, TEXT_SHARE = 22, 1 / 50  # of the monitor's height: TEXT_PX is too small on a fine monitor
NAMES = {key: name for key, (name, _) in KEYS.items()} | {"=": "alpha+", " ": "freeze", "?": "help"}


class Window:
    """A resizable window or the full screen. `show` hands a picture over at once; `presented` says when the screen showed it.

    Its pixels are the screen's own: SDL asks a desktop that scales windows not to scale this one.
    """

    def __init__(
        self,
        size_px: tuple[int, int],
        title: str,
        fullscreen: bool = False,
        monitor: str = "",
        hint: str = "",
        renderer: bool | None = None,
        lock: KeyLock | None = None,
    ) -> None:
        """size_px: (width, height) of the pictures. monitor: a number or name, as for `monitors.find_monitor`; empty: the desktop
        chooses. hint: a line over the picture for HINT_S, or until a key is pressed. renderer: draw by SDL's renderer; None: if
        that is cheaper, with a GPU or on Wayland. lock: only its code has an effect, and quits; other keys, buttons and drops
        have none. Raises UserError if no window can be opened, or the monitor is missing."""
        self._lock = lock
        self._title, self._fullscreen, self._wanted = title, fullscreen, monitor
        try:
            driver = window_system.start()
            self._renderer = window_system.uses_renderer(driver) if renderer is None else renderer
            # A Wayland compositor takes the newest complete picture at each blank: waiting for the previous one would only make
            # the next one older.
            self._wait = driver != "wayland"
            self._monitors = monitors()
            on = find_monitor(monitor, self._monitors) if monitor else self._monitors[0]
            largest = min(SCREEN_SHARE * on.width / size_px[0], SCREEN_SHARE * on.height / size_px[1])
            scale = min(max(1.0, max(SMALLEST_PX, SMALLEST_SHARE * on.width) / max(size_px)), largest)
            self._windowed = max(1, round(size_px[0] * scale)), max(1, round(size_px[1] * scale))
            self._at: tuple[int, int] | None = None
            if monitor:
                self._at = on.x + (on.width - self._windowed[0]) // 2, on.y + (on.height - self._windowed[1]) // 2
            self._number = self._handed = 0  # of the picture, and of the hand-over: a picture may be drawn again
            self._numbers: dict[int, int] = {}  # hand-over -> picture
            self._window = self._opened(on)
        except UserError:
            pygame.display.quit()
            raise
        except pygame.error as error:
            raise UserError(f"no window can be opened: {error}", "use --display none or --display file:OUT.mkv") from None
        pygame.font.init()
        self._on = on
        self._picture: NDArray[np.uint8] | None = None
        self._shown_px = fit_area(size_px, self._painter.size_px())[2]
        self._lines: list[str] = []
        self._inset: NDArray[np.uint8] | None = None
        self._help = False
        self._hint, self._hint_end_ns = hint, time.monotonic_ns() + int(HINT_S * 1e9)
        self._panel: pygame.Surface | None = None
        self._said: list[str] = []
        self._words: pygame.Surface | None = None  # short lines at the bottom
        self._progress: float | None = None  # share of a thin line along the bottom; None without
        self._menu_of: Callable[[tuple[int, int]], pygame.Surface] | None = None
        self._menu: pygame.Surface | None = None
        self._pair: Pair | None = None
        self._pointer = Pointer()
        self._bar, self._bar_state, self._bar_until_ns = Bar(), BarState(), 0
        self._text_px = TEXT_PX
        self._how = ""
        self._laid: NDArray[np.uint8] | None = None
        self._make_panel()

    def _opened(self, on: Monitor) -> pygame.Window:
        if self._fullscreen:
            whole, place = (on.width, on.height), (on.x, on.y)
            window = pygame.Window(self._title, whole, place, fullscreen_desktop=True, allow_high_dpi=True)
        else:
            at = self._at or pygame.WINDOWPOS_UNDEFINED
            window = pygame.Window(self._title, self._windowed, at, resizable=True, allow_high_dpi=True)
        pygame.mouse.set_visible(not self._fullscreen)
        window.set_icon(window_system.icon())
        self._painter: Painter = open_painter(window, self._renderer, self._wait)
        self._presentation: Presentation | None = open_presentation(window)
        self._numbers.clear()
        return window

    def _closed(self) -> None:
        if self._presentation is not None:
            self._presentation.close()
        self._window.destroy()

    @property
    def blanks_by(self) -> str:
        """See `Display.blanks_by`."""
        return self._presentation.name if self._presentation is not None else ""

    def nominal_hz(self) -> float:
        """The refresh rate that the window's monitor claims."""
        return nominal_hz(self._on.number)

    def presented(self) -> list[Presented]:
        """See `Display.presented`."""
        answers: list[Presented] = []
        for answer in self._presentation.take() if self._presentation is not None else []:
            number = self._numbers.pop(answer.serial, None)
            drawn_again = number in self._numbers.values()
            if number is not None and (answer.t_ns or not drawn_again):
                answers.append(Presented(number, answer.t_ns, answer.period_ns))
        return answers

    def _toggle(self) -> None:
        """Switches to full screen on the chosen monitor, or else on the window's; or back to the window's old position.

        Opens the window again: without a window manager SDL neither moves nor shrinks an open one.
        """
        if not self._fullscreen:
            self._windowed, self._at = self._window.size, self._window.position
        self._monitors = monitors()  # monitors may have been plugged or unplugged
        self._on = self._here()
        if self._wanted:
            with contextlib.suppress(UserError):  # the chosen one was unplugged
                self._on = find_monitor(self._wanted, self._monitors)
        self._fullscreen = not self._fullscreen
        self._closed()
        self._window = self._opened(self._on)

    def _here(self) -> Monitor:
        """The monitor on which the window is."""
        number = monitor_of(self._window)
        return next((each for each in self._monitors if each.number == number), self._monitors[0])

    @property
    def monitor(self) -> Monitor:
        """The monitor on which the window is."""
        return self._on

    def width_mm(self) -> float | None:
        """See `Display.width_mm`."""
        if not self._shown_px:
            return None
        if self._on.pixel_mm:
            return self._shown_px * self._on.pixel_mm
        scaled = self._painter.size_px()[0] / self._window.size[0]
        return self._shown_px / (self._on.width * scaled) * USUAL_MM

    def to_picture(self, position: tuple[int, int]) -> tuple[float, float]:
        """Converts a position in the window to px of the picture."""
        if self._picture is None:
            return 0.0, 0.0
        rows, cols = self._picture.shape[:2]
        surface_px, window = self._painter.size_px(), self._window.size
        x, y, width, height = fit_area((cols, rows), surface_px)
        x_px, y_px = position[0] * surface_px[0] / window[0], position[1] * surface_px[1] / window[1]
        return (x_px - x) * cols / width, (y_px - y) * rows / height

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        """See `Display.show`; returns the time at which the window system accepted the picture."""
        self._picture, self._pair, self._how = picture, pair, how
        self._number += 1
        self._draw()
        return time.monotonic_ns()

    def _draw(self) -> None:
        if self._picture is None:
            return
        panels: Panels = [] if self._menu is None else [(self._menu, self._menu_at())]
        if self._panel is not None:
            panels.append((self._panel, (12, 12)))
        size_px, below_px = self._painter.size_px(), 0
        if self._bar_until_ns:
            bar = self._bar.draw(size_px, self._text_px, self._bar_state, self._in_bar(self._at_px()))
            below_px = bar.get_height()
            panels.append((bar, (0, size_px[1] - below_px)))
        if self._progress is not None:
            line = pygame.Surface((max(1, round(self._progress * size_px[0])), PROGRESS_PX))
            line.fill((255, 255, 255))
            panels.append((line, (0, size_px[1] - PROGRESS_PX)))
        if self._words is not None:
            wide, high = self._words.get_size()
            panels.append((self._words, ((size_px[0] - wide) // 2, size_px[1] - high - 12 - below_px)))
        _, _, width, height = fit_area((self._picture.shape[1], self._picture.shape[0]), size_px)
        self._shown_px = width
        picture = self._picture
        if self._pair is not None:
            picture = self._laid = laid_out(self._pair, self._how, size_px, self._first_row(), self._laid)
        self._painter.paint(picture, panels, picture.shape[:2] == (height, width) or self._pair is not None)
        self._handed += 1
        if self._presentation is None:
            self._painter.swap()
            return
        self._numbers[self._handed] = self._number
        self._presentation.expect(self._handed)
        self._painter.swap()
        self._presentation.handed_over(self._handed)

    def events(self) -> list[str]:
        """See `Display.events`. Handles full screen and help itself, and redraws after it was covered or resized."""
        pressed, again, resized, keyed = [], False, False, False
        for event in window_system.take_events():
            if self._lock and event.type in (pygame.QUIT, pygame.KEYDOWN, pygame.DROPFILE):
                if event.type == pygame.KEYDOWN and self._lock.opens(event.unicode):
                    pressed.append("quit")
            elif event.type == pygame.QUIT:
                pressed.append("quit")
            elif event.type == pygame.KEYDOWN:
                keyed = True
                name = window_system.KEY_CODES.get(event.key) or NAMES.get(event.unicode.lower())
                if name == "escape":
                    name = "help" if self._help else "choose" if self._menu_of else "fullscreen" if self._fullscreen else None
                if name:
                    pressed.append(name)
            elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1 and self._menu is not None:
                (x, y), scale = self._menu_at(), self._painter.size_px()[0] / self._window.size[0]
                pressed.append(f"click {round(event.pos[0] * scale) - x} {round(event.pos[1] * scale) - y}")
            elif event.type in MOUSE and not self._lock:
                self._bar_until_ns = time.monotonic_ns() + int(SHOWN_S * 1e9)
                self._pointer = self._moved(event)
                if name := self._bar_event(event):
                    pressed.append(name)
                again = True
            elif event.type == pygame.DROPFILE:
                pressed.append(f"drop {event.file}".rstrip())
            elif event.type == pygame.WINDOWEXPOSED:
                again = True
            elif event.type in (pygame.WINDOWSIZECHANGED, pygame.WINDOWDISPLAYCHANGED):
                resized = True
        for name in pressed:
            if name == "fullscreen":
                self._toggle()
                resized = True
            elif name == "help":
                self._help = not self._help
                self._make_panel()
                again = True
        if self._hint and (keyed or time.monotonic_ns() > self._hint_end_ns):
            self._hint, again = "", True
            self._make_panel()
        if self._bar_until_ns and time.monotonic_ns() > self._bar_until_ns and not self._pointer.left:
            self._bar_until_ns, again = 0, True
            pygame.mouse.set_visible(self._menu_of is not None or not self._fullscreen)
        if resized:
            self._on = self._here()
            self._make_panel()
        if again or resized:
            self._draw()
        return pressed

    def pointer(self) -> Pointer:
        """See `Display.pointer`."""
        pointer, self._pointer = self._pointer, attrs.evolve(self._pointer, wheel=0)
        return pointer

    def _moved(self, event: pygame.Event) -> Pointer:
        """The pointer after an event of the mouse."""
        if event.type == pygame.MOUSEWHEEL:
            return attrs.evolve(self._pointer, wheel=self._pointer.wheel + event.y)
        width, height = self._window.size
        x, y = min(max(event.pos[0] / width, 0.0), 1.0), min(max(event.pos[1] / height, 0.0), 1.0)
        held = {"left": self._pointer.left, "right": self._pointer.right}
        if event.type != pygame.MOUSEMOTION and event.button in (1, 3):
            held["left" if event.button == 1 else "right"] = event.type == pygame.MOUSEBUTTONDOWN
        return Pointer(x, y, **held, wheel=self._pointer.wheel)

    def bar(self, state: BarState) -> None:
        """See `Display.bar`."""
        if state != self._bar_state:
            self._bar_state = state
            if self._bar_until_ns:
                self._draw()

    def _at_px(self) -> tuple[int, int]:
        """The pointer, px of the window."""
        width, height = self._painter.size_px()
        return round(self._pointer.x * width), round(self._pointer.y * height)

    def _in_bar(self, at_px: tuple[int, int]) -> tuple[int, int] | None:
        """A place of the window in px of the bar; None outside of it."""
        if self._bar.surface is None or not self._bar_until_ns or self._menu_of is not None:
            return None
        y = at_px[1] - self._painter.size_px()[1] + self._bar.surface.get_height()
        return (at_px[0], y) if y >= 0 else None

    def _bar_event(self, event: pygame.Event) -> str:
        """What a click or touch in the bar, or a move of its slider, means."""
        at = self._at_px()
        if event.type == pygame.MOUSEBUTTONUP:
            self._bar.release()
        elif event.type == pygame.MOUSEMOTION:
            pygame.mouse.set_visible(True)
            return self._bar.slide(at[0])
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1 and (inside := self._in_bar(at)) is not None:
            self._pointer = attrs.evolve(self._pointer, left=False)
            return self._bar.press(*inside)
        return ""

    def notices(self) -> list[DisplayNotice]:
        return []

    def menu(self, draw: Callable[[tuple[int, int]], pygame.Surface] | None) -> None:
        """See `Display.menu`."""
        self._menu_of = draw
        pygame.mouse.set_visible(draw is not None or not self._fullscreen)
        self._make_panel()
        self._draw()

    def _menu_at(self) -> tuple[int, int]:
        """Where the menu is in the window."""
        (width, height), (wide, high) = self._painter.size_px(), self._menu.get_size() if self._menu else (0, 0)
        return (width - wide) // 2, (height - high) // 2

    def title(self, name: str) -> None:
        """See `Display.title`."""
        self._title = self._window.title = f"lfpipe: {window_system.drawable(name)}"

    def say(self, lines: list[str]) -> None:
        """See `Display.say`."""
        if lines != self._said:
            self._said = list(lines)
            self._make_panel()
            self._draw()

    def progress(self, share: float | None) -> None:
        """See `Display.progress`."""
        if share != self._progress:
            self._progress = share
            self._draw()

    def _first_row(self) -> int:
        """The row of the screen on which the window's picture begins: known on X and in full screen."""
        return 0 if self._fullscreen else max(0, int(self._window.position[1] - self._on.y))

    def overlay(self, lines: list[str], inset: NDArray[np.uint8] | None = None) -> None:
        """See `Display.overlay`."""
        if lines != self._lines or inset is not self._inset:
            self._lines, self._inset = list(lines), inset if lines else None
            self._make_panel()
            self._draw()

    def _make_panel(self) -> None:
        lines = [*self._lines, *([f"{key}\t{text}" for key, (_, text) in KEYS.items()] if self._help else [])]
        if self._hint and not lines and self._menu_of is None:
            lines = [self._hint]
        width_px, height_px = self._painter.size_px()
        scaled = width_px / self._window.size[0]
        self._text_px = text_px = round(max(TEXT_PX, TEXT_SHARE * self._on.height) * scaled)
        room = width_px - 24, height_px - 24
        self._panel = panel(lines, self._inset, text_px, room) if lines else None
        size_px = round(MENU_SHARE * width_px), round(MENU_SHARE * height_px)
        self._menu = self._menu_of(size_px) if self._menu_of else None
        self._words = panel(self._said, None, text_px, room) if self._said else None

    def close(self) -> None:
        self._closed()
        pygame.display.quit()
