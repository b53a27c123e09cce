"""`lfpipe kiosk` and `lfpipe up --kiosk`: exhibitions without an operator."""

import os
import time
import unicodedata
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click

from lfpipe import config as configuration
from lfpipe.cli.terminal import PATH, Group, print_result, say
from lfpipe.config import user_file
from lfpipe.config.session_options import Window
from lfpipe.errors import UserError, quoted
from lfpipe.files.safe_files import read_text, write_file, write_output
from lfpipe.host.files import exists
from lfpipe.host.worker import python
from lfpipe.render.display.display import parse_display

AGAIN_S = 2.0  # pause between a failed session and the next
VARIABLE = "LFPIPE_KIOSK_CODE"
UNIT = """\
[Unit]
Description=lfpipe: light-field exhibition
PartOf=graphical-session.target
After=graphical-session.target
StartLimitIntervalSec=0

[Service]
ExecStart={command}
Restart=always
RestartSec=2
# Typing the code ends the session with exit code 0; systemd must not restart it then.
RestartPreventExitStatus=0

[Install]
WantedBy=graphical-session.target
"""


def kiosk_code(file: Path | None) -> str:
    """The code that ends an exhibition, from a file or the environment: every user of the machine
    can read a command line.

    Raises UserError if there is none, if it cannot be typed, or if a child could type it by chance.
    """
    if file is not None:
        code = read_text(
            file, f"--code-file {file}", "specify a file that contains the code"
        ).strip()
    elif not (code := os.environ.get(VARIABLE, "")):
        raise UserError(
            "an exhibition needs a code that ends it",
            f"write one to a file: --code-file FILE, or set {VARIABLE}",
        )
    if not (4 <= len(code) <= 64 and code.isascii() and code.isprintable() and len(set(code)) > 1):
        raise UserError(
            "the code must have 4 to 64 ASCII characters, not all the same",
            "choose one such as leave2026",
        )
    return code


def until_it_ends(first: Callable[[], int], again: Callable[[], int]) -> int:
    """Runs sessions until one ends without failure: an exhibition has no operator to restart it."""
    run = first
    while True:
        try:
            if not run():
                return 0
        except UserError as error:  # the camera is still unplugged, the disk still full
            say(f"error: {error}")
        say(f"the exhibition restarts in {AGAIN_S:g} s")
        time.sleep(AGAIN_S)
        run = again


def up(
    proceed: Callable[..., Any],
    *,
    kiosk: bool,
    code_file: Path | None,
    every_s: int | None,
    title: str | None,
    **values: Any,
) -> Any:
    """`lfpipe up` as an exhibition: a full-screen window that only the code closes. It restarts
    after a failure and does not need its camera to start.
    """
    if not kiosk:
        if code_file:  # the user must not believe that the window is locked
            raise click.UsageError("--code-file needs --kiosk")
        if every_s or title:
            raise click.UsageError(f"{'--every' if every_s else '--title'} needs --kiosk")
        return proceed(**values)
    display = values["display"] or "fullscreen"
    if not isinstance(parse_display(display), Window):
        raise UserError(
            f"--kiosk with --display {display}: an exhibition needs a screen",
            "leave out one or the other",
        )
    locked = {
        "display": display,
        "lock_code": kiosk_code(code_file),
        "every_s": float(every_s or 0),
        "title": title or "",
        "wait_for_camera": True,
        "run_policy": until_it_ends,
    }
    return proceed(**values | locked)


@click.group(cls=Group)
def kiosk() -> None:
    """Install an exhibition; see also `lfpipe up --kiosk`."""


@kiosk.command()
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE...", type=PATH)
@click.option(
    "--code-file",
    type=PATH,
    metavar="FILE",
    help=f"A file with its code; or set {VARIABLE}.",
)
@click.option(
    "--every",
    "every_s",
    type=click.IntRange(1, 86400),
    metavar="SECONDS",
    help="The time after which the next scene is shown.",
)
@click.option("--title", metavar="TEXT", help="The title on the screen.")
def install(
    scenes: tuple[Path, ...], code_file: Path | None, every_s: int | None, title: str | None
) -> None:
    """Write a systemd unit that shows SCENE in full screen when your desktop starts, and restarts
    it after a failure.
    """
    from lfpipe.scene.pack import cache_dir, named_scene

    code = kiosk_code(code_file)
    cache = cache_dir(configuration.load().scene)
    scenes = tuple(named_scene(path, cache).resolve() for path in scenes)
    if missing := [str(path) for path in scenes if not exists(path)]:
        raise UserError(
            f"{', '.join(missing)}: not found", "name light fields, or a folder of them"
        )
    unit, kept = _files()
    options = ("up", "--session", "kiosk", "--kiosk", "--code-file")
    timed = ("--every", str(every_s)) if every_s else ()
    named = ("--title", title) if title else ()
    words = python("lfpipe", *options, str(kept), *timed, *named, *map(str, scenes))
    require_plain(words)
    unit.parent.mkdir(parents=True, exist_ok=True)
    write_file(kept, code.encode())
    write_output(
        unit, UNIT.format(command=" ".join(map(_quoted, words))).encode(errors="surrogateescape")
    )
    print_result(unit)
    say("start it, now and with every desktop: systemctl --user enable --now lfpipe-kiosk")


def _files() -> tuple[Path, Path]:
    """The unit, and the code that it reads."""
    import platformdirs

    unit = Path(platformdirs.user_config_dir("systemd")) / "user" / "lfpipe-kiosk.service"
    return unit, user_file().parent / "kiosk-code"


@kiosk.command()
def remove() -> None:
    """Remove what `install` wrote."""
    for path in filter(exists, _files()):
        path.unlink()
        print_result(path)
    say("end it first: systemctl --user disable --now lfpipe-kiosk")


def require_plain(words: Iterable[str]) -> None:
    """Raises UserError for a word that a line of a unit or of a desktop entry cannot hold: a line
    break would begin a line of its own, which another program executes.
    """
    for word in words:
        if odd := next((c for c in word if unicodedata.category(c) in ("Cc", "Zl", "Zp")), ""):
            raise UserError(
                f"{quoted(word)}: contains {odd!a}, which a service cannot have in its command",
                "rename the file or folder",
            )


def _quoted(word: str) -> str:
    """Quotes word for a systemd unit, so that systemd expands nothing in it."""
    escaped = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{escaped}"'
