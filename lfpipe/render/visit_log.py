"""Number of visitors of an exhibition by hour: only counts, no faces and no times of single visits."""

import time
from pathlib import Path

from lfpipe.files.safe_files import read_text, replaced
from lfpipe.host.paths import is_missing
from lfpipe.render.presence import ViewerState

MAX_BYTES = 4 << 20  # two decades
BEGINNING = (ViewerState.ARRIVING, ViewerState.EXCHANGED)


class VisitLog:
    """Counts visitors in a CSV file of lines `2026-11-21 15:00,12`. Raises UserError if path is a different kind of file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._counts: dict[str, int] = {}
        if not is_missing(path):
            text = read_text(path, MAX_BYTES, str(path), "name a file that no other program wrote")
            for hour, _, count in (line.partition(",") for line in text.splitlines()[1:]):
                self._counts[hour] = int(count) if count.isdecimal() else 0

    def follow(self, before: ViewerState, now: ViewerState) -> None:
        """Handles a change of state: somebody who rests before the screen is a visitor. Raises OSError; the count is kept for the
        next call."""
        if now is ViewerState.SEATED and before in BEGINNING:
            hour = time.strftime("%Y-%m-%d %H:00")
            self._counts[hour] = self._counts.get(hour, 0) + 1
            lines = ["hour,visits", *(f"{each},{count}" for each, count in sorted(self._counts.items()))]
            with replaced(self._path) as file:
                file.write(("\n".join(lines) + "\n").encode())
