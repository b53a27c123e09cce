"""`lfpipe calibrate`: measures the focal length of the camera, which true depth needs."""

import math
from collections.abc import Mapping
from pathlib import Path

import attrs
import click

from lfpipe.capture.live_source import PREFIX, check_live, is_live
from lfpipe.capture.open_source import camera_name
from lfpipe.cli.options import CAMERA, Number, with_config
from lfpipe.cli.terminal import print_result
from lfpipe.config import Config, load, user_file
from lfpipe.config.user_files import PLACED, camera_file, write_keys
from lfpipe.errors import UserError
from lfpipe.live.shared_scene import two_cameras
from lfpipe.monitor.calibrate import by_card, by_eyes, placement_of
from lfpipe.monitor.camera_window import FARTHEST_MM, NEAREST_MM

BANK_CARD_MM = 85.60  # ISO/IEC 7810 ID-1
USUAL_DEG = (30, 130)  # fields of view of webcams, narrow to wide


@click.command()
@click.argument("scene", required=False, metavar="[live:SRC]")
@CAMERA
@click.option(
    "--distance",
    "distance_mm",
    type=Number(NEAREST_MM, FARTHEST_MM),
    default=600.0,
    show_default=True,
    metavar="MM",
    help="Distance from the camera to your eyes, or to the card; the window can change it.",
)
@click.option(
    "--by",
    type=click.Choice(["eyes", "card"]),
    default="eyes",
    show_default=True,
    help="Measure your eyes, or a bank card.",
)
@with_config
def calibrate(
    scene: str | None, camera: str | None, distance_mm: float, by: str, config: Config
) -> None:
    """Measure the focal length of the camera and store it under the camera's name.

    Sit with your eyes MM from the camera (or hold a bank card there, parallel to the camera) and
    follow the instructions in the window. It can check the result at a second distance. Without a
    screen, the measurement starts when eyes are detected.

    With live:SRC, measure and store instead how the second of two cameras stands against the first.
    """
    if scene is not None:
        _calibrate_pair(scene, config)
        return
    name = camera_name(camera or config.camera.source)
    measured = (by_card if by == "card" else by_eyes)(config, camera, distance_mm)
    size_px, distance_mm = measured.size_px, measured.distance_mm
    size_mm = BANK_CARD_MM if by == "card" else config.screen.eyes_mm
    focal_px = round(size_px * distance_mm / size_mm, 1)
    width_px = config.camera.frame_px[0]
    fov_deg = math.degrees(2 * math.atan(width_px / 2 / focal_px))
    print_result(f"{size_mm:g} mm at a distance of {distance_mm:g} mm measure {size_px:.1f} px")
    print_result(f"focal length {focal_px} px, field of view {fov_deg:.1f} degrees")
    if measured.check_mm is not None:
        set_mm, found_mm = measured.check_mm
        print_result(
            f"{found_mm:.0f} mm measured at {set_mm:g} mm, off by {found_mm - set_mm:+.0f} mm"
        )
    if not USUAL_DEG[0] <= fov_deg <= USUAL_DEG[1]:
        raise UserError(
            f"a field of view of {fov_deg:.1f} degrees is not stored: webcams have {USUAL_DEG[0]}"
            f" to {USUAL_DEG[1]} degrees",
            f"measure again at {distance_mm:g} mm; if the lens really has this field of view, set"
            f" focal_px = {focal_px} under [camera] in {user_file()}",
        )
    if by == "eyes":
        print_result(
            f"by screen.eyes_mm, {size_mm:g} mm between your eyes: the mean, 63, is at most 8 % off"
            " for most people"
        )
    store(camera_file(), name, {"focal_px": focal_px, "width_px": width_px})
    print_result(f"stored for {name} in {camera_file()}")
    if load().camera.focal_px != "auto":
        store(user_file(), "camera", {"focal_px": None})
        print_result(
            f"camera.focal_px removed from {user_file()}: it would override the measured value"
        )


def _calibrate_pair(text: str, config: Config) -> None:
    live = check_live(text if is_live(text) else PREFIX + text, config)
    if not two_cameras(live):
        raise UserError(f"{text}: not two cameras", "name a camera with two views, or two cameras")
    name = camera_name(live.source)
    placed = placement_of(live, config)
    if placed.swapped:
        print_result("the first camera delivers the right view: views swapped")
    sense = "clockwise" if placed.rotation_deg >= 0 else "anticlockwise"
    print_result(f"right camera is rotated by {abs(placed.rotation_deg):.1f} degrees {sense}")
    lies = f"{abs(placed.height_px):.1f} px {'lower' if placed.height_px >= 0 else 'higher'}"
    print_result(f"its picture lies {lies}, and is {placed.scale:.3f} times as large")
    values = {key: round(value, 4) for key, value in attrs.asdict(placed).items()}
    values |= {"swapped": placed.swapped, "width_px": live.width_px}
    store(camera_file(), PLACED + name, values)
    print_result(f"stored for {name} in {camera_file()}")


def store(path: Path, section: str, values: Mapping[str, float | str | None]) -> None:
    """Writes the values under [section] of path.

    Raises UserError if it is not TOML, OSError if it cannot be written.
    """
    try:
        write_keys(path, section, values)
    except ValueError as error:
        lines = " and ".join(f"{key} = {value}" for key, value in values.items())
        raise UserError(f"{path}: {error}", f"write {lines} under [{section}] there") from None
