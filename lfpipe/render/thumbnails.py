"""Scenes to choose from: a grid of thumbnails over the picture, with the camera's picture beside them."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_area
from lfpipe.render.window_system import drawable, pygame
from lfpipe.scene.contact_sheet import stored_view
from lfpipe.scene.open_scene import packed

KEPT_PX = (480, 360)  # of a thumbnail, at most
COLS, CELL_LINES = 4, 9  # cells across a window of at least this many lines of text; height of a cell in lines
CELL_SHAPE = 0.75  # of a picture's area, at most: height over width
TEXT_PX, TEXT_SHARE = 18, 1 / 32
HEAD = "arrows and Enter, or a click, show a scene; Delete takes it off this page; Tab goes back"
HINTS = "g tests the glasses, h shows all keys; drop a folder of views onto the window"
WHITE, GREY, BACK = (255, 255, 255), (150, 150, 150), (0, 0, 0, 215)
LEAST_NARROW = 1.5  # letters may be as many times narrower
STEPS = {"less": (0, -1), "more": (0, 1), "up": (-1, 0), "down": (1, 0)}


def thumbnail(scene: str, settings: config.Scene) -> NDArray[np.uint8] | None:
    """The middle view of a packed scene, uint8 (height, width, 3) RGB of at most KEPT_PX; None without a pack."""
    try:
        field = packed(scene, settings)
    except UserError:
        return None
    return None if field is None else _small(stored_view(field, field.rows // 2, field.cols // 2))


def _small(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    _, _, width, height = fit_area((picture.shape[1], picture.shape[0]), KEPT_PX)
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


class Thumbnails:
    """The grid. scenes: paths. at: the selected one. settings: of the packs. with_camera: reserve a cell for its picture."""

    def __init__(self, scenes: Sequence[str], at: int, settings: config.Scene, with_camera: bool = False) -> None:
        self.scenes, self.at = list(scenes), at
        self._settings = settings
        self._pictures: dict[int, NDArray[np.uint8] | None] = {}
        self._with_camera, self._caption = with_camera, "the camera"
        self._camera: NDArray[np.uint8] | None = None
        self._grid, self._per_page = (1, 1), 1  # rows, cols of a page; scenes on it
        self._cell_px, self._head_px = (1, 1), 0

    def load_one(self) -> bool:
        """Reads the next thumbnail; returns whether there was one."""
        missing = next((k for k in range(len(self.scenes)) if k not in self._pictures), None)
        if missing is None:
            return False
        self._pictures[missing] = thumbnail(self.scenes[missing], self._settings)
        return True

    def camera(self, frame: NDArray[np.uint8], caption: str) -> None:
        """Sets the camera's picture, uint8 (height, width, 3) BGR, mirrored."""
        self._camera, self._caption = _small(frame)[:, ::-1, ::-1], caption

    def remove(self) -> str:
        """Takes the selected scene out; returns it."""
        kept = {number - (number > self.at): picture for number, picture in self._pictures.items() if number != self.at}
        self._pictures = kept
        scene = self.scenes.pop(self.at)
        self.at = min(self.at, len(self.scenes) - 1)
        return scene

    def move(self, key: str) -> bool:
        """Selects another scene by the name of a key; returns whether the key does that."""
        if key in STEPS:
            down, across = STEPS[key]
            self.at = min(max(self.at + down * self._grid[1] + across, 0), len(self.scenes) - 1)
        elif key in ("next", "previous"):
            self.at = min(max(self.at + self._per_page * (1 if key == "next" else -1), 0), len(self.scenes) - 1)
        else:
            return False
        return True

    def scene_at(self, x: int, y: int) -> int | None:
        """The number of the scene whose cell is at (x, y) of the last drawing."""
        rows, cols = self._grid
        row, col = (y - self._head_px) // self._cell_px[1], x // self._cell_px[0]
        place = row * cols + col
        number = self.at // self._per_page * self._per_page + place
        inside = 0 <= row < rows and 0 <= col < cols and place < self._per_page
        return number if inside and number < len(self.scenes) else None

    def draw(self, room_px: tuple[int, int]) -> pygame.Surface:
        """The page with the selected scene, for (width, height) px."""
        width, height = room_px
        font = pygame.font.Font(None, max(TEXT_PX, round(TEXT_SHARE * height)))
        line = font.get_linesize()
        cells = len(self.scenes) + self._with_camera
        cols = max(1, min(COLS, width // (CELL_LINES * line), cells))
        self._head_px = 3 * line
        rows = max(1, min((height - self._head_px) // (CELL_LINES * line), -(-cells // cols)))
        high_px = min((height - self._head_px) // rows, round(CELL_SHAPE * width / cols) + 2 * line)
        self._grid, self._cell_px = (rows, cols), (width // cols, high_px)
        made = pygame.Surface(room_px, pygame.SRCALPHA)
        made.fill(BACK)
        camera = self._with_camera and rows * cols > 1  # the last cell of every page is the camera's
        self._per_page = rows * cols - camera
        first = self.at // self._per_page * self._per_page
        page = f"   {self.at + 1} of {len(self.scenes)}" if self._per_page < len(self.scenes) else ""
        made.blit(font.render(_cut(font, HEAD + page, width - line), True, WHITE), (line // 2, line // 2))
        made.blit(font.render(_cut(font, HINTS, width - line), True, GREY), (line // 2, 3 * line // 2))
        for number in range(first, min(first + self._per_page, len(self.scenes))):
            name = Path(self.scenes[number]).name
            unread = "" if number not in self._pictures else "not opened yet"
            self._cell(made, font, number - first, self._pictures.get(number), name, unread, number == self.at)
        if camera:
            self._cell(made, font, min(len(self.scenes) - first, self._per_page), self._camera, self._caption, "", False)
        return made

    def _cell(
        self,
        made: pygame.Surface,
        font: pygame.font.Font,
        place: int,
        picture: NDArray[np.uint8] | None,
        name: str,
        instead: str,
        selected: bool,
    ) -> None:
        """Draws a cell: the picture above its name."""
        line, (wide, high) = font.get_linesize(), self._cell_px
        row, col = divmod(place, self._grid[1])
        x, y = col * wide, self._head_px + row * high
        made.fill(BACK, (x, y, wide, high))
        room = max(wide - line, 1), max(high - 2 * line, 1)
        if picture is not None:
            left, top, width, height = fit_area((picture.shape[1], picture.shape[0]), room)
            small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
            made.blit(
                pygame.image.frombuffer(small.tobytes(), (width, height), "RGB"), (x + line // 2 + left, y + line // 4 + top)
            )
        elif instead:
            made.blit(font.render(_cut(font, instead, room[0]), True, GREY), (x + line // 2, y + room[1] // 2))
        made.blit(_fitted(font, name, room[0]), (x + line // 2, y + high - 3 * line // 2))
        if selected:
            pygame.draw.rect(made, WHITE, (x + 2, y, wide - 4, high - line // 4), max(2, line // 8))


def _fitted(font: pygame.font.Font, text: str, width_px: int) -> pygame.Surface:
    """text in white: narrower letters where it does not fit, and cut where those do not either."""
    text = _cut(font, text, round(LEAST_NARROW * width_px))
    words = font.render(text, True, WHITE)
    share = width_px / max(words.get_width(), 1)
    return words if share >= 1 else pygame.transform.smoothscale_by(words, (share, 1.0))


def _cut(font: pygame.font.Font, text: str, width_px: int) -> str:
    """text, shortened to fit."""
    text = drawable(text)
    while len(text) > 1 and font.size(text)[0] > width_px:
        text = text[:-2].rstrip() + "…"
    return text
