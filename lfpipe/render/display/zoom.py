"""The part of the picture that the window shows: the wheel zooms, a drag pans."""

import attrs

STEP = 1.2  # of the factor for a step of the wheel: four double it
MOST = 8.0  # a pixel of the scene is then as large as a letter
Share = tuple[float, float]


@attrs.define
class Zoom:
    """A factor, and the place in the middle as shares of the picture's width and height."""

    factor: float = 1.0
    x: float = 0.5
    y: float = 0.5

    @property
    def active(self) -> bool:
        """Whether a part of the picture is hidden."""
        return self.factor > 1.0

    def turn(self, steps: int, at: Share) -> None:
        """Zooms in by steps of the wheel, or out; the place under the pointer stays.

        at: the pointer, as shares of what is shown.
        """
        before = self.factor
        self.factor = min(max(before * STEP**steps, 1.0), MOST)
        change = 1 / before - 1 / self.factor
        self._move(self.x + (at[0] - 0.5) * change, self.y + (at[1] - 0.5) * change)

    def drag(self, by: Share) -> None:
        """Moves the picture with the pointer. by: shares of what is shown."""
        self._move(self.x - by[0] / self.factor, self.y - by[1] / self.factor)

    def reset(self) -> None:
        """Shows the whole picture."""
        self.factor, self.x, self.y = 1.0, 0.5, 0.5

    def _move(self, x: float, y: float) -> None:
        half = 0.5 / self.factor
        self.x, self.y = (min(max(at, half), 1 - half) for at in (x, y))

    def part(self, rows: int, cols: int) -> tuple[slice, slice]:
        """The part of a picture of that size."""
        high, wide = max(1, round(rows / self.factor)), max(1, round(cols / self.factor))
        top = min(max(round(self.y * rows - high / 2), 0), rows - high)
        left = min(max(round(self.x * cols - wide / 2), 0), cols - wide)
        return slice(top, top + high), slice(left, left + wide)
