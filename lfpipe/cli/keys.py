"""`lfpipe keys`: who may drive a session over a network."""

from __future__ import annotations

from pathlib import Path

import click


@click.group()
def keys() -> None:
    """Keys for a session that is driven over a network: control.bind = "tcp://HOST:PORT"."""


@keys.command()
@click.argument("folder", required=False, metavar="[DIR]", type=click.Path(path_type=Path))
def new(folder: Path | None) -> None:
    """Make a server's pair of keys and a client's that it lets in, in DIR or with your settings."""
    from lfpipe.transport import curve

    folder = folder or curve.folder()
    for path in curve.make_keys(folder):
        click.echo(path)
    click.echo(
        f"a client on another machine needs {folder}/client.public, client.secret and server.public; tell nobody else a secret",
        err=True,
    )


@keys.command("list")
@click.argument("folder", required=False, metavar="[DIR]", type=click.Path(path_type=Path))
def list_keys(folder: Path | None) -> None:
    """List the clients that the keys of DIR, or yours, let in."""
    from lfpipe.transport import curve

    for name, key in curve.allowed(folder or curve.folder()).items():
        click.echo(f"{key.decode()}  {name}")
