"""`lfpipe calibrate`: measures the camera's focal length, which true depth rests on."""

from __future__ import annotations

import click

from lfpipe.cli.options import with_config

USUAL_DEG = (30, 130)  # of webcams, from those for meetings to wide ones


@click.command()
@click.option("--camera", "camera", metavar="SRC", help="As for `lfpipe up`.  [default: the first camera]")
@click.option("--distance", "distance_mm", type=click.FloatRange(100, 5000), default=600.0, show_default=True, metavar="MM",
              help="From the camera to your eyes, or to the card.")  # fmt: skip
@click.option("--by", type=click.Choice(["eyes", "card", "leaning"]), default="eyes", show_default=True,
              help="Measure your eyes, or a bank card whose short edges you click, or where the camera stands.")  # fmt: skip
@click.option("--eyes-mm", type=click.FloatRange(40, 80), metavar="MM", help="Distance between your pupils; 63 is the mean.")
@with_config
def calibrate(
    camera: str | None, distance_mm: float, by: str, eyes_mm: float | None, sets: tuple[str, ...], config_file: str | None
) -> None:
    """Measure the camera's focal length and store it in your settings.

    Sit so that a tape measure reads MM from the camera to your eyes (or hold a bank card there, flat to the camera) and follow
    the window. Without a screen, the eyes are measured as soon as they are detected.

    --by leaning measures where the camera stands, once its focal length is known: look straight at the middle of the screen,
    with your eyes level with it, and lean slowly in and out.
    """
    import math

    from lfpipe.config import load, user_file
    from lfpipe.config.camera_pose import EYES_MM
    from lfpipe.config.user_settings import write_key
    from lfpipe.errors import UserError
    from lfpipe.observe.calibrate import by_card, by_eyes, by_leaning
    from lfpipe.render.geometry import BANK_CARD_MM, focal_px_from

    config = load(config_file, sets)
    if by == "leaning":
        above_mm, tilt_deg = (round(value, 1) for value in by_leaning(config, camera, eyes_mm or EYES_MM))
        try:
            for name, value in (("above_mm", above_mm), ("tilt_deg", tilt_deg)):
                write_key(user_file(), "camera", name, value)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            remedy = f"add above_mm = {above_mm} and tilt_deg = {tilt_deg} under [camera] there"
            raise UserError(f"{user_file()}: {why}", remedy) from None
        click.echo(f"camera {above_mm} mm above the middle of the screen, looking down by {tilt_deg} degrees")
        click.echo(f"camera.above_mm and camera.tilt_deg written to {user_file()}")
        return
    size_px = by_card(config, camera, distance_mm) if by == "card" else by_eyes(config, camera, distance_mm)
    size_mm = BANK_CARD_MM if by == "card" else eyes_mm or EYES_MM
    focal_px = round(focal_px_from(size_px, size_mm, distance_mm), 1)
    fov_deg = math.degrees(2 * math.atan(config.camera.width_px / 2 / focal_px))
    if not USUAL_DEG[0] <= fov_deg <= USUAL_DEG[1]:
        raise UserError(
            f"{size_mm:g} mm at {distance_mm:g} mm measured {size_px:.1f} px: a field of view of {fov_deg:.0f} degrees, which is"
            f" implausible for a webcam ({USUAL_DEG[0]} to {USUAL_DEG[1]}); nothing was written",
            f"pass the measured distance with --distance; if the camera is so, put focal_px = {focal_px} into {user_file()}",
        )
    try:
        write_key(user_file(), "camera", "focal_px", focal_px)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise UserError(f"{user_file()}: {why}", f"add focal_px = {focal_px} under [camera] there") from None
    click.echo(f"{size_mm:g} mm at {distance_mm:g} mm are {size_px:.1f} px")
    click.echo(f"focal length {focal_px} px, field of view {fov_deg:.1f} degrees")
    if by == "eyes" and eyes_mm is None:
        click.echo(f"assuming {EYES_MM:g} mm between your eyes (8 % off at most, for most people)")
        click.echo("--eyes-mm MM or --by card is more accurate")
    click.echo(f"camera.focal_px = {focal_px} written to {user_file()}")
