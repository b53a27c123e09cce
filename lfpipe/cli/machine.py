"""Commands about this machine: `lfpipe cameras`, `doctor`, `models` and `config`."""

import json
import os
from pathlib import Path
from typing import Any

import click

from lfpipe.capture import camera_list
from lfpipe.capture.camera_controls import control_texts
from lfpipe.capture.live_source import WIDE
from lfpipe.capture.pixel_formats import DECODED
from lfpipe.capture.v4l2_device import V4L2Device
from lfpipe.cli.options import JSON, OVERWRITE, PATH, with_config
from lfpipe.cli.plugged import Group
from lfpipe.cli.terminal import filled, print_result, say
from lfpipe.config import Config, load, user_file
from lfpipe.config.user_files import commented
from lfpipe.errors import UserError
from lfpipe.files.safe_files import write_file
from lfpipe.monitor.doctor import checks, write_report
from lfpipe.scene.cache import cache_dir
from lfpipe.track.models import SHA256, fetch_models, find_model, install_models, missing_models


@click.command()
@JSON
def cameras(as_json: bool) -> None:
    """List cameras with pixel formats, frame sizes, rates and controls, the best for faces first.

    Each size is listed with its highest rate; --json lists all rates. Pass the path or the name to
    --camera: camera:/dev/video0, camera:NAME.
    """
    listed: list[dict[str, Any]] = []
    ranking = camera_list.ranked(camera_list.cameras())
    for number, (device, doubt) in enumerate((one.device, one.doubt) for one in ranking):
        about: dict[str, Any] = {
            "camera": f"camera:{device.path}",
            "name": device.name,
            "used": not number,
            "doubt": doubt,
            "stereo": False,
            "formats": [],
            "controls": [],
            "trouble": "",
        }
        try:
            about["formats"], about["controls"], about["stereo"] = camera_list.asking(
                device.path,
                lambda opened: (_formats(opened, as_json), control_texts(opened), _is_wide(opened)),
            )
        except OSError as error:
            about["trouble"] = os.strerror(error.errno or 0)
        listed.append(about)
    if as_json:
        print_result(json.dumps({"cameras": listed}))
        return
    for about in listed:
        use = (
            "used by default"
            if about["used"]
            else f"not used by default: {about['doubt'] or 'not the first'}"
        )
        print_result(f"{about['camera']}  {about['name']}  ({use})")
        if about["stereo"]:
            path = about["camera"].removeprefix("camera:")
            print_result(f"  two views side by side, it seems: lfpipe up live:{path}")
        lines = (
            [about["trouble"]]
            if about["trouble"]
            else [*(about["formats"] or ["formats unknown"]), *about["controls"]]
        )
        print_result("\n".join(filled(line, "  ") for line in lines))
    if not listed:
        print_result("no camera found; --demo and --camera file:PATH work without one")


def _is_wide(device: V4L2Device) -> bool:
    """Whether all frames are as wide as two views side by side."""
    sizes = [size for name in device.fourccs() if name in DECODED for size in device.sizes(name)]
    return bool(sizes) and all(size.width_px >= WIDE * size.height_px for size in sizes)


def _formats(device: V4L2Device, every_rate: bool) -> list[str]:
    """One line per group of pixel formats with equal sizes, with all rates or the highest."""
    groups: dict[str, list[str]] = {}
    for fourcc in device.fourccs():
        sizes = []
        for size in device.sizes(fourcc) if fourcc in DECODED else ():
            rates = ",".join(
                f"{hz:.4g}" for hz in (size.rates_hz if every_rate else size.rates_hz[:1])
            )
            sizes.append(f"{size.text}@{rates}" if rates else size.text)
        groups.setdefault(" ".join(sizes) if fourcc in DECODED else "cannot be decoded", []).append(
            fourcc
        )
    return [f"{' '.join(fourccs)}: {text}" for text, fourccs in groups.items()]


@click.command()
@click.option(
    "--report",
    type=PATH,
    metavar="FILE",
    help=("Also write a ZIP for a bug report: versions, settings, logs and state of sessions."),
)
@OVERWRITE
@click.option("-v", "--verbose", is_flag=True, help="Also list what needs no remedy.")
def doctor(report: Path | None, overwrite: bool, verbose: bool) -> int:
    """Check this machine: the outcome, then each problem with its remedy.

    The exit code is 1 if a session would fail. A missing screen is no failure: sessions can write
    to a file.
    """
    results = checks()
    if report is not None:
        write_report(report, results, overwrite)
    failed = [check.name for check in results if not check.ok]
    print_result(f"sessions fail here: {', '.join(failed)}" if failed else "sessions run here")
    for check in (one for one in results if verbose or one.remedy or not one.ok):
        head = f"{'ok  ' if check.ok else 'FAIL'} {check.name:<12} "
        print_result(filled(check.detail, head))
        if check.remedy:
            print_result(filled(f"remedy: {check.remedy}", " " * len(head)))
    return int(bool(failed))


@click.group(cls=Group)
def models() -> None:
    """Manage the face networks that tracking needs."""


@models.command()
@click.option(
    "--from",
    "wheel",
    type=PATH,
    metavar="WHEEL",
    help="Use this file instead of the network.",
)
def get(wheel: Path | None) -> None:
    """Download the face networks with uv or pip if the package mediapipe is not installed.

    They are verified by checksum and stored in your data folder. The first `lfpipe up` does this,
    too.
    """
    if wheel is not None:
        install_models(wheel)
    elif missing_models():
        fetch_models(say)
    for relative, sha256 in SHA256.items():
        print_result(f"{sha256[:8]}  {find_model(relative)}")


@click.group(cls=Group)
def config() -> None:
    """Write, show and check the configuration."""


@config.command()
@click.argument("path", required=False, type=PATH)
def init(path: Path | None) -> None:
    """Write every key with its default, unit and meaning to PATH, or to your settings."""
    path = path or user_file()
    if os.path.lexists(path):
        raise UserError(f"{path} exists", "remove it first, or name another PATH")
    write_file(path, commented().encode(), 0o644)
    print_result(path)


@config.command()
@with_config
def show(config: Config) -> None:
    """Print the configuration that `lfpipe up` would use."""
    print_result(commented(config).rstrip("\n"))


@config.command()
@click.argument("path", required=False)
def check(path: str | None) -> None:
    """Check PATH, or your settings, and report every wrong key."""
    cache_dir(load(path).scene)
    print_result(f"{path or user_file()}: ok")
