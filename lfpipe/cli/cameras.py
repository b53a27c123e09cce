"""`lfpipe cameras`: lists the cameras that --camera accepts."""

from __future__ import annotations

import json
import os
from typing import Any

import click


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def cameras(as_json: bool) -> None:
    """List cameras with their pixel formats, frame sizes and rates, without starting them."""
    from lfpipe.capture import v4l2

    found: list[dict[str, Any]] = []
    for device in v4l2.cameras():
        about: dict[str, Any] = {"camera": f"camera:{device.path}", "name": device.name, "formats": [], "trouble": ""}
        try:
            about["formats"] = v4l2.formats(device.path, rates=True)
        except OSError as error:
            about["trouble"] = os.strerror(error.errno or 0)
        found.append(about)
    if as_json:
        click.echo(json.dumps({"cameras": found}))
        return
    for about in found:
        click.echo(f"{about['camera']}  {about['name']}")
        for line in about["formats"] or [about["trouble"] or "reports no formats"]:
            click.echo(f"  {line}")
    if not found:
        click.echo("no camera found; --demo and --camera file:PATH work without one")
