"""The page that opens a scene from a disk: folders, and files that may be scenes (key l).

The supervisor lists a folder in a process of its own: a disk may be slow, or a network drive dead.
"""

from collections.abc import Sequence
from pathlib import Path

from lfpipe.render.display.overlay import Event, Item, Menu, Overlay
from lfpipe.render.ui.pages import Page
from lfpipe.transport.context import Context
from lfpipe.transport.control import Answer

HINT = "Click, or use the arrows and Enter. To show the views in this folder, open it."
TITLE_CHARS = 32  # of the end of a path: beside them, a small window has the page's buttons
READING = Overlay(lines=("Reading the folder ...",))


def folder_menu(folder: Path, folders: Sequence[str], files: Sequence[str], more: int) -> Menu:
    """The content of a folder by names. more: how many have no place."""
    fixed = (
        Item("Open this folder", Event("load", str(folder)), icon="choose"),
        Item("Parent folder", Event("enter-folder", str(folder.parent)), icon="up"),
    )
    inner = (Item(name, Event("enter-folder", str(folder / name)), icon="open") for name in folders)
    scenes = (Item(name, Event("load", str(folder / name)), icon="file") for name in files)
    hint = HINT + (f"\n{more} more are not listed: drop them here." if more else "")
    # with files, it may be a scene itself
    at = 0 if files or not folders else len(fixed)
    title = str(folder)
    if len(title) > TITLE_CHARS:
        title = f"…{title[-TITLE_CHARS:]}"
    return Menu(title, hint, (*fixed, *inner, *scenes), at)


class FolderPage(Page):
    """The content of a folder; another one is entered, a file or the folder itself loaded."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._folder = ""  # the supervisor chooses the first one
        self._menu: Menu | None = None
        self._waits = False  # for the content of a folder

    def open(self) -> None:
        """Reads the folder again: files may be new."""
        self._enter(self._folder)

    def _enter(self, folder: str) -> None:
        if not self._waits:
            self._waits = True
            self._context.request("folder", **({"path": folder} if folder else {}))

    def show(self, answer: Answer) -> None:
        """Shows what the supervisor has listed; after a refusal, what was shown before."""
        self._waits = False
        if not answer.ok:
            return
        found = answer.values
        self._folder = found["path"]
        self._menu = folder_menu(
            Path(self._folder), found["folders"], found["files"], found["more"]
        )

    def take(self, event: Event) -> bool:
        """Enters a folder."""
        if event.name == "enter-folder":
            self._enter(event.text)
        return event.name == "enter-folder"

    def overlay(self, t_ns: int) -> Overlay:
        return READING if self._menu is None else Overlay(menu=self._menu)
