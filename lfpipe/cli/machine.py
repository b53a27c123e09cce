"""Commands about this machine: `lfpipe cameras`, `calibrate`, `doctor`, `models` and `config`."""

import json
import os
from contextlib import closing
from pathlib import Path
from typing import Any

import attrs
import click
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture import camera_list
from lfpipe.capture.camera_list import control_texts
from lfpipe.capture.open_source import WIDE, camera_name, check_live, live_camera, open_source
from lfpipe.capture.spec import LIVE, is_live
from lfpipe.capture.v4l2_device import DECODED, V4L2Device
from lfpipe.cli.terminal import (
    CAMERA,
    JSON,
    OVERWRITE,
    PATH,
    SESSION,
    Group,
    Number,
    filled,
    print_result,
    say,
    with_config,
    with_settings,
)
from lfpipe.config import Config, LiveSource, Placement, load, user_file
from lfpipe.config.check import PLACED, camera_file, commented, write_keys
from lfpipe.config.session_options import Window
from lfpipe.errors import UserError
from lfpipe.files.safe_files import write_file
from lfpipe.live.field import FAST_FRAMES, Estimator
from lfpipe.live.records import pairs_in_need, two_cameras
from lfpipe.monitor.doctor import checks, write_report
from lfpipe.monitor.session_reader import snapshot
from lfpipe.render.display.display import has_display
from lfpipe.render.ui.pages import FARTHEST_CM, NEAREST_CM, SEAT_MM
from lfpipe.scene.pack import cache_dir, demo_scene
from lfpipe.supervisor import rundir
from lfpipe.track.models import SHA256, fetch_models, find_model, install_models, missing_models


@click.command()
@JSON
def cameras(as_json: bool) -> None:
    """List cameras with pixel formats, frame sizes, rates and controls, the best for faces first.

    Each size is listed with its highest rate; --json lists all rates. Pass the path or the name to
    --camera: camera:/dev/video0, camera:NAME.
    """
    rows: list[dict[str, Any]] = []
    for number, (device, doubt) in enumerate(camera_list.ranked(camera_list.cameras())):
        facts: dict[str, Any] = {
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
            facts["formats"], facts["controls"], facts["stereo"] = camera_list.asking(
                device.path,
                lambda opened: (
                    _formats(opened, as_json),
                    control_texts(opened),
                    _is_wide(opened),
                ),
            )
        except OSError as error:
            facts["trouble"] = os.strerror(error.errno or 0)
        rows.append(facts)
    if as_json:
        print_result(json.dumps({"cameras": rows}))
        return
    for facts in rows:
        use = (
            "used by default"
            if facts["used"]
            else f"not used by default: {facts['doubt'] or 'not the first'}"
        )
        print_result(f"{facts['camera']}  {facts['name']}  ({use})")
        if facts["stereo"]:
            path = facts["camera"].removeprefix("camera:")
            print_result(f"  two views side by side, it seems: lfpipe up live:{path}")
        lines = (
            [facts["trouble"]]
            if facts["trouble"]
            else [*(facts["formats"] or ["formats unknown"]), *facts["controls"]]
        )
        print_result("\n".join(filled(line, "  ") for line in lines))
    if not rows:
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


@click.command()
@click.argument("scene", required=False, metavar="[live:SRC]")
@CAMERA
@click.option(
    "--distance",
    "distance_mm",
    type=Number(10 * NEAREST_CM, 10 * FARTHEST_CM),
    default=SEAT_MM,
    show_default=True,
    metavar="MM",
    help="Distance from the camera to your eyes; the page can change it.",
)
@SESSION
@with_settings
def calibrate(
    *,
    scene: str | None,
    camera: str | None,
    distance_mm: float,
    session_name: str,
    config_file: str | None,
    sets: tuple[str, ...],
) -> int:
    """Measure the focal length of the camera and store it under the camera's name.

    Opens the page Calibrate in the window of the running session, or in a new one: sit with your
    eyes MM from the camera.

    With live:SRC, measure and store instead how the second of two cameras stands against the first.
    """
    config = load(config_file, sets)
    if scene is not None:
        _calibrate_pair(scene, config)
        return 0
    if not has_display():
        raise UserError(
            "calibrate needs a screen: the page shows the camera's picture",
            "run it on a desktop, or set camera.focal_px if you know it",
        )
    options = snapshot(session_name).options if session_name in rundir.running() else None
    if options is not None and isinstance(options.display, Window):
        if camera not in (None, options.viewer.source):
            raise UserError(
                f"--camera {camera}: the open window uses {options.viewer.source or 'another'}",
                f"exchange it first: `lfpipe ctl --session {session_name} viewer {camera}`",
            )
        rundir.ask(session_name, {"cmd": "action", "name": "calibrate", "value": distance_mm}, 3.0)
        print_result("calibrate in the open window")
        return 0
    from lfpipe.cli.sessions import UpArguments, launch

    return launch(
        UpArguments(
            scenes=(demo_scene(cache_dir(config.scene)),),
            camera=camera,
            session_name=session_name,
            config_file=config_file,
            sets=sets,
            calibrate_mm=distance_mm,
        )
    )


def _calibrate_pair(text: str, config: Config) -> None:
    live = check_live(text if is_live(text) else LIVE + text, config)
    if not two_cameras(live):
        raise UserError(f"{text}: not two cameras", "name a camera with two views, or two cameras")
    name = camera_name(live.source)
    placement = placement_of(live, config)
    if placement.swapped:
        print_result("the first camera delivers the right view: views swapped")
    sense = "clockwise" if placement.rotation_deg >= 0 else "anticlockwise"
    print_result(f"right camera is rotated by {abs(placement.rotation_deg):.1f} degrees {sense}")
    lies = f"{abs(placement.height_px):.1f} px {'lower' if placement.height_px >= 0 else 'higher'}"
    print_result(f"its picture lies {lies}, and is {placement.scale:.3f} times as large")
    values = {key: round(value, 4) for key, value in attrs.asdict(placement).items()}
    values |= {"swapped": placement.swapped, "width_px": live.width_px}
    write_keys(camera_file(), PLACED + name, values)
    print_result(f"stored for {name} in {camera_file()}")


PATIENCE_FRAMES = 600  # before giving up: 20 s at 30 Hz


def placement_of(live: LiveSource, config: Config) -> Placement:
    """How the second one of two cameras stands against the first, from features matched in
    both views.

    Raises UserError if too few features match.
    """
    estimator = Estimator(attrs.evolve(live, placement=None), aligns=True)
    assert estimator.alignment is not None
    width_px, height_px = live.frame_px
    frame: NDArray[np.uint8] = np.empty((height_px, width_px, 3), np.uint8)
    pair = pairs_in_need(live, [(0.0, 0.5)])
    with closing(open_source(live.source, live_camera(config, live.frame_px))) as source:
        for _ in range(PATIENCE_FRAMES):
            if source.read(frame) is None:
                break
            estimator.estimate(frame, pair)
            if estimator.alignment.frames >= 2 * FAST_FRAMES:
                return estimator.alignment.placement(estimator.swapped)
    raise UserError(
        f"{live.source}: too few features match between the two views",
        "point the cameras at something with texture, in good light",
    )
