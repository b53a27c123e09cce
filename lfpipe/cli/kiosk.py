"""`lfpipe kiosk`: an exhibition that starts with the desktop."""

import sys
from pathlib import Path

import click

from lfpipe.cli import completions
from lfpipe.host.paths import exists

UNIT = """\
[Unit]
Description=lfpipe: a light field you look into
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


@click.group()
def kiosk() -> None:
    """Run an exhibition: see also `lfpipe up --kiosk CODE`."""


@kiosk.command()
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE...", type=click.Path(path_type=Path),
                shell_complete=completions.scenes)  # fmt: skip
@click.option("--code", required=True, metavar="CODE", help="Typing CODE on its keyboard ends the session.")
@click.option("--user", is_flag=True, required=True, help="Install the unit for this user's desktop.")
@click.option("--visits", type=click.Path(path_type=Path), metavar="FILE", help="Count visitors by the hour, as CSV.")
def install(scenes: tuple[Path, ...], code: str, user: bool, visits: Path | None) -> None:
    """Write a systemd unit that shows SCENE in full screen when this user's desktop starts, and restarts it after any failure."""
    import platformdirs

    from lfpipe.config.session_options import check_code
    from lfpipe.errors import UserError
    from lfpipe.files.safe_files import reason, replaced

    check_code(code)
    if missing := [str(path) for path in scenes if not exists(path)]:
        raise UserError(f"{', '.join(missing)}: not found", "name light fields, or a folder of them")
    words = [sys.executable, "-m", "lfpipe", "up", "--session", "kiosk", "--kiosk", code]
    words += ["--visits", str(visits.resolve())] if visits else []
    words += [str(path.resolve()) for path in scenes]
    path = Path(platformdirs.user_config_dir("systemd")) / "user" / "lfpipe-kiosk.service"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replaced(path, 0o600) as file:  # it holds the code
            file.write(UNIT.format(command=" ".join(map(_quoted, words))).encode(errors="surrogateescape"))
    except OSError as error:
        raise UserError(f"{path}: {reason(error)}", "make that folder writable") from None
    click.echo(path)
    click.echo("start it, now and with every desktop: systemctl --user enable --now lfpipe-kiosk", err=True)


def _quoted(word: str) -> str:
    """Quotes word for a systemd unit, so that systemd expands nothing in it."""
    escaped = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{escaped}"'
