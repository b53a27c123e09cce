"""`lfpipe models`: the face networks on this machine."""

from pathlib import Path

import click


@click.group()
def models() -> None:
    """Manage the face networks that tracking needs."""


@models.command()
@click.option("--from", "wheel", type=click.Path(path_type=Path), metavar="WHEEL", help="Take them from this file; no network.")
def get(wheel: Path | None) -> None:
    """Fetch the face networks with uv or pip if the package mediapipe is not installed.

    Their checksums are verified, and they are kept in your data folder. The first `lfpipe up` does the same.
    """
    from lfpipe.track.models import SHA256, fetch_models, find_model, install_models, missing_models

    if wheel is not None:
        install_models(wheel)
    elif missing_models():
        fetch_models(lambda text: click.echo(text, err=True))
    for relative, sha256 in SHA256.items():
        click.echo(f"{sha256[:8]}  {find_model(relative)}")
