"""`lfpipe calibrate`: measures the focal length of the camera, which true depth needs."""

import attrs
import click

from lfpipe.capture.live_source import check_live
from lfpipe.capture.open_source import camera_name
from lfpipe.capture.spec import LIVE, is_live
from lfpipe.cli.options import CAMERA, SESSION, Number, with_settings
from lfpipe.cli.terminal import print_result
from lfpipe.config import Config, load
from lfpipe.config.modes import Window
from lfpipe.config.user_files import PLACED, camera_file, write_keys
from lfpipe.errors import UserError
from lfpipe.live.shared_scene import two_cameras
from lfpipe.monitor.calibrate import placement_of
from lfpipe.monitor.session_reader import snapshot
from lfpipe.render.display.open_display import has_display
from lfpipe.render.ui.pages import FARTHEST_CM, NEAREST_CM, USUAL_MM
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.demo import demo_scene
from lfpipe.supervisor import rundir


@click.command()
@click.argument("scene", required=False, metavar="[live:SRC]")
@CAMERA
@click.option(
    "--distance",
    "distance_mm",
    type=Number(10 * NEAREST_CM, 10 * FARTHEST_CM),
    default=USUAL_MM,
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
    return _open_page(session_name, camera, distance_mm, config_file, sets)


def _open_page(
    session_name: str,
    camera: str | None,
    distance_mm: float,
    config_file: str | None,
    sets: tuple[str, ...],
) -> int:
    """Opens the page in the window of the session, or starts one with it; returns the exit code."""
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
    from lfpipe.cli.launch import UpArguments, launch

    return launch(
        UpArguments(
            scenes=(demo_scene(cache_dir(load(config_file, sets).scene)),),
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
    placed = placement_of(live, config)
    if placed.swapped:
        print_result("the first camera delivers the right view: views swapped")
    sense = "clockwise" if placed.rotation_deg >= 0 else "anticlockwise"
    print_result(f"right camera is rotated by {abs(placed.rotation_deg):.1f} degrees {sense}")
    lies = f"{abs(placed.height_px):.1f} px {'lower' if placed.height_px >= 0 else 'higher'}"
    print_result(f"its picture lies {lies}, and is {placed.scale:.3f} times as large")
    values = {key: round(value, 4) for key, value in attrs.asdict(placed).items()}
    values |= {"swapped": placed.swapped, "width_px": live.width_px}
    write_keys(camera_file(), PLACED + name, values)
    print_result(f"stored for {name} in {camera_file()}")
