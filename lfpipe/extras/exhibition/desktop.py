"""`lfpipe desktop`: the entry in the desktop's menu, and "Open with" for light fields."""

import shutil
import subprocess
import sys
from pathlib import Path

import click

from lfpipe.cli.terminal import Group, print_error, print_result
from lfpipe.errors import UserError
from lfpipe.extras.exhibition.kiosk import require_plain
from lfpipe.files.safe_files import write_output
from lfpipe.host.files import exists

TYPES = (
    "image/png;image/jpeg;image/tiff;image/webp;image/heic;application/zip;application/x-hdf;"
    "video/mp4;video/quicktime;video/webm;video/x-matroska;"
)
# what shows a text, the first that is installed
DIALOGS = (
    ("zenity", "--error", "--no-markup", "--text"),
    ("kdialog", "--error"),
    ("notify-send", "lfpipe"),
)
# folders are not among the types: some desktops would then open every folder with lfpipe
ENTRY = """\
[Desktop Entry]
Type=Application
Name=lfpipe
Comment=Look into a light field
Icon=lfpipe
Terminal=false
Categories=Graphics;Viewer;
Exec={command}{more}
"""
ICON = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 64 64">
<circle cx="24" cy="32" r="20" fill="#f00"/>
<circle cx="40" cy="32" r="20" fill="#0ff" style="mix-blend-mode:screen"/>
</svg>
"""


def _files() -> dict[Path, str]:
    """path -> content: the entry, one that opens a file, and their icon."""
    import platformdirs

    data = platformdirs.user_data_path()
    require_plain([sys.executable])
    program = sys.executable.replace("%", "%%")
    for character in '\\"`$':  # quoted for Exec, and once more as a value of the file
        program = program.replace(character, "\\\\" + character)
    command = f'"{program}" -P -m lfpipe.extras.exhibition'
    opens = f" up %f\nNoDisplay=true\nMimeType={TYPES}"
    return {
        data / "applications" / "lfpipe.desktop": ENTRY.format(command=command, more=""),
        data / "applications" / "lfpipe-open.desktop": ENTRY.format(command=command, more=opens),
        data / "icons" / "hicolor" / "scalable" / "apps" / "lfpipe.svg": ICON,
    }


def show_error(error: UserError) -> None:
    """Prints an error, and shows it in a dialog if a program for that is installed."""
    print_error(error)
    text = f"error: {error}"
    installed = [command for command in DIALOGS if shutil.which(command[0])]
    if installed:
        subprocess.run([*installed[0], text], check=False)


@click.group(cls=Group)
def desktop() -> None:
    """Add lfpipe to the desktop's menu and to "Open with"."""


@desktop.command()
def install() -> None:
    """Write a menu entry, an icon and file associations."""
    for path, text in _files().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_output(path, text.encode(errors="surrogateescape"))
        print_result(path)


@desktop.command()
def remove() -> None:
    """Remove what `install` wrote."""
    for path in filter(exists, _files()):
        path.unlink()
        print_result(path)
