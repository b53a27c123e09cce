"""`lfpipe config`: writes, shows and checks the configuration."""

import os
from pathlib import Path

import click

from lfpipe.cli.options import with_config


@click.group()
def config() -> None:
    """Write, show and check the configuration."""


@config.command()
@click.argument("path", required=False, type=click.Path(path_type=Path))
def init(path: Path | None) -> None:
    """Write every key with its default, unit and meaning to PATH, or to your own settings."""
    from lfpipe.config import user_file
    from lfpipe.config.text import commented
    from lfpipe.errors import UserError
    from lfpipe.files.safe_files import reason, replaced

    path = path or user_file()
    try:
        if os.path.lexists(path):
            raise UserError(f"{path} exists", "remove it first, or name another PATH")
        path.parent.mkdir(parents=True, exist_ok=True)
        with replaced(path, 0o644) as file:
            file.write(commented().encode())
    except OSError as error:
        raise UserError(f"{path}: {reason(error)}", "name a PATH that you may write to") from None
    click.echo(path)


@config.command()
@with_config
def show(config_file: str | None, sets: tuple[str, ...]) -> None:
    """Print the configuration as `lfpipe up` would use it."""
    from lfpipe.config import load
    from lfpipe.config.text import commented

    click.echo(commented(load(config_file, sets)), nl=False)


@config.command()
@click.argument("path", required=False)
def check(path: str | None) -> None:
    """Check PATH, or your own settings, and report every wrong key."""
    from lfpipe.config import load, user_file

    load(path)
    click.echo(f"{path or user_file()}: ok")
