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
from lfpipe.render.display import KEYS, BarState, DisplayNotice, Pointer
from lfpipe.render.layers import MOUSE, Layers, moved
from lfpipe.render.monitors import Monitor, find_monitor, monitor_of, monitors
from lfpipe.render.painters import Painter, open_painter
from lfpipe.render.pair_layout import Pair, laid_out
from lfpipe.render.window_system import KeyLock, nominal_hz, open_presentation, pygame

USUAL_MM = 531.0  # width of a 24-inch screen of 16:9, for monitors that report no size
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
            self._windowed = on.window_for(size_px)
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
        self._layers = Layers(hint)
        self._pair: Pair | None = None
        self._pointer = Pointer()
        self._how = ""
        self._laid: NDArray[np.uint8] | None = None
        self._place_layers()

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
        size_px = self._painter.size_px()
        panels = self._layers.panels(self._pointer.at_px(size_px))
        _, _, width, height = fit_area((self._picture.shape[1], self._picture.shape[0]), size_px)
        self._shown_px = width
        picture = self._picture
        if self._pair is not None:
            picture = self._laid = laid_out(self._pair, self._how, size_px, self._first_row(), self._laid)
        self._painter.paint(picture, panels, picture.shape[:2] == (height, width) or self._pair is not None)
        self._handed += 1
        if self._presentation is not None:
            self._numbers[self._handed] = self._number
            self._presentation.expect(self._handed)
        self._painter.swap()
        if self._presentation is not None:
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
                    name = self._layers.closes or ("fullscreen" if self._fullscreen else "")
                if name:
                    pressed.append(name)
            elif event.type in MOUSE and not self._lock:
                name, changed = self._mouse(event)
                again |= changed
                if name:
                    pressed.append(name)
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
                self._layers.help = not self._layers.help
                self._place_layers()
                again = True
        if self._layers.expire(keyed, self._pointer.left):
            again = True
            pygame.mouse.set_visible(self._layers.menu is not None or not self._fullscreen or self._layers.bar_is_shown)
        if resized:
            self._on = self._here()
            self._place_layers()
        if again or resized:
            self._draw()
        return pressed

    def pointer(self) -> Pointer:
        """See `Display.pointer`."""
        pointer, self._pointer = self._pointer, attrs.evolve(self._pointer, wheel=0)
        return pointer

    def _mouse(self, event: pygame.Event) -> tuple[str, bool]:
        """The event that the mouse causes, "" for none, and whether the bar looks different now."""
        self._pointer = moved(self._pointer, event, self._window.size)
        pygame.mouse.set_visible(True)
        name, changed = self._layers.mouse(event, self._pointer.at_px(self._painter.size_px()))
        if name:
            self._pointer = attrs.evolve(self._pointer, left=False)
        return name, changed

    def notices(self) -> list[DisplayNotice]:
        return []

    def menu(self, draw: Callable[[tuple[int, int]], pygame.Surface] | None) -> None:
        """See `Display.menu`."""
        self._layers.menu = draw
        pygame.mouse.set_visible(draw is not None or not self._fullscreen)
        self._draw_layers()

    def title(self, name: str) -> None:
        """See `Display.title`."""
        self._title = self._window.title = f"lfpipe: {window_system.drawable(name)}"

    def say(self, lines: list[str]) -> None:
        """See `Display.say`."""
        if lines != self._layers.words:
            self._layers.words = list(lines)
            self._draw_layers()

    def progress(self, share: float | None) -> None:
        """See `Display.progress`."""
        if share != self._layers.progress:
            self._layers.progress = share
            self._draw()

    def bar(self, state: BarState) -> None:
        """See `Display.bar`."""
        if state != self._layers.bar_state:
            self._layers.bar_state = state
            if self._layers.bar_is_shown:
                self._draw()

    def _first_row(self) -> int:
        """The row of the screen on which the window's picture begins: known on X and in full screen."""
        return 0 if self._fullscreen else max(0, int(self._window.position[1] - self._on.y))

    def overlay(self, lines: list[str], inset: NDArray[np.uint8] | None = None) -> None:
        """See `Display.overlay`."""
        if lines != self._layers.lines or inset is not self._layers.inset:
            self._layers.lines, self._layers.inset = list(lines), inset if lines else None
            self._draw_layers()

    def _place_layers(self) -> None:
        size_px = self._painter.size_px()
        self._layers.place(size_px, round(max(TEXT_PX, TEXT_SHARE * self._on.height) * size_px[0] / self._window.size[0]))

    def _draw_layers(self) -> None:
        self._place_layers()
        self._draw()

    def close(self) -> None:
        self._closed()
        pygame.display.quit()
