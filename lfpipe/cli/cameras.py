"""`lfpipe cameras`: lists the cameras that --camera accepts."""

from __future__ import annotations

import json
import os
import shutil
import textwrap
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from lfpipe.capture.v4l2_device import FrameSizes, V4L2Device


@click.command()
@click.option("--all", "everything", is_flag=True, help="Show every rate of every size of every pixel format.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def cameras(everything: bool, as_json: bool) -> None:
    """List cameras with pixel formats, frame sizes, rates and controls, without starting them.

    Each size is shown with its highest rate. Give --camera the path or the name: camera:/dev/video0, camera:NAME.
    """
    from lfpipe.capture.camera_device import known

    width = shutil.get_terminal_size((100, 24)).columns
    found: list[dict[str, Any]] = []
    for device in known().cameras():
        about: dict[str, Any] = {"camera": f"camera:{device.path}", "name": device.name}
        about |= {"formats": [], "controls": [], "trouble": ""}
        lines: list[str] = []
        try:
            modes, about["controls"] = known().asking(device.path, lambda opened: _about(opened, everything or as_json))
            about["formats"] = [_every(fourcc, sizes) for fourcc, sizes in modes.items()]
            lines = about["formats"] if everything else _folded(modes)
            lines = [*(lines or ["formats unknown"]), *about["controls"]]
        except OSError as error:
            about["trouble"] = os.strerror(error.errno or 0)
            lines = [about["trouble"]]
        found.append(about)
        if not as_json:
            click.echo(f"{about['camera']}  {about['name']}")
            for line in lines:
                click.echo(textwrap.fill(line, width, initial_indent="  ", subsequent_indent="      ", break_on_hyphens=False))
    if as_json:
        click.echo(json.dumps({"cameras": found}))
    elif not found:
        click.echo("no camera found; --demo and --camera file:PATH work without one")


def _about(device: V4L2Device, everything: bool) -> tuple[dict[str, list[FrameSizes]], list[str]]:
    """Pixel formats with their sizes, and controls. Formats that cannot be decoded are included only if everything is set."""
    from lfpipe.capture.camera_controls import control_states
    from lfpipe.capture.pixel_formats import DECODED

    modes = {fourcc: device.sizes(fourcc) if everything or fourcc in DECODED else [] for fourcc in device.fourccs()}
    return modes, [state.text for state in control_states(device)]


def _every(fourcc: str, sizes: list[FrameSizes]) -> str:
    rates = [",".join(f"{hz:.4g}" for hz in size.rates_hz) for size in sizes]
    return " ".join([fourcc, *(f"{size.text}@{rate}" if rate else size.text for size, rate in zip(sizes, rates, strict=True))])


def _folded(modes: dict[str, list[FrameSizes]]) -> list[str]:
    """One line per group of formats with equal sizes and rates (highest rate per size), and one for undecodable formats."""
    from lfpipe.capture.pixel_formats import DECODED

    groups: dict[str, list[str]] = {}
    for fourcc, sizes in modes.items():
        if fourcc in DECODED:
            text = " ".join(f"{size.text}@{size.rates_hz[0]:.4g}" if size.rates_hz else size.text for size in sizes)
            groups.setdefault(text, []).append(fourcc)
    useless = len(modes) - sum(map(len, groups.values()))
    lines = [f"{' '.join(fourccs)}: {text}" for text, fourccs in groups.items()]
    return lines + ([f"and {useless} formats that cannot be decoded (--all lists them)"] if useless else [])
