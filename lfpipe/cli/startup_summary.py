"""Prints the settings that `lfpipe up` starts with, in five lines."""

from lfpipe.capture.open_source import camera_name
from lfpipe.config import Config
from lfpipe.host.machine import has_gpu
from lfpipe.render.compositor import mixed_as
from lfpipe.render.geometry import parallax
from lfpipe.render.monitors import detect_monitors, loop_doubt
from lfpipe.render.plan import Plan
from lfpipe.scene.lightfield import LightField


def startup_lines(config: Config, field: LightField, plan: Plan, camera: str, display: str) -> list[str]:
    """Scene, plan, camera, alpha and picture. camera: the source. display: as for `--display`."""
    without = ", ".join(item.what for item in plan.left_out)
    left_out = f"; left out: {without} (`lfpipe scene plan` explains why)" if without else ""
    render = mixed_as(field, plan.method, config.render)
    on_screen = display in ("window", "fullscreen")
    at_hz = "of the screen" if on_screen and render.rate_hz == "auto" else f"at {render.nominal_hz:g} Hz"
    clock = f"every refresh {at_hz}" if render.clock == "display" else "every camera frame"
    by = ", drawn by the CPU (no GPU found)" if on_screen and not has_gpu() else ""
    if not plan.needs_tracking:
        source, alpha = "none: a single view needs no eyes", "none: the scene has one view"
    else:
        source = f"{camera}; eyes by {config.track.engine}, filter {config.track.filter}"
        source = "none, and no tracking: move the mouse to look around" if camera == "mouse" else source
        chosen = parallax(config, field, config.camera.frame_px[0], None)
        depth = "" if chosen.compression is None else f", {chosen.compression:.0%} of true depth"
        across = f"{field.cols} columns" if field.cols > 1 else f"{field.rows} rows"
        asked = "set" if isinstance(render.alpha_px, float) else f"{render.alpha_px}, at {chosen.distance_mm:.0f} mm"
        alpha = f"{chosen.alpha_px:.1f} px/view ({asked}): {chosen.views_between_eyes:.1f} of {across} between your eyes{depth}"
    return [
        f"scene   {field.name}: {field.rows}x{field.cols} views of {field.width_px}x{field.height_px}",
        f"plan    views by {plan.method}{left_out}",
        f"camera  {source}",
        f"alpha   {alpha}",
        f"picture {render.anaglyph} in {render.light} light, {clock}, to {display}{by}",
    ]


def loop_lines(config: Config, camera: str, display: str) -> list[str]:
    """The delay of the loop if pictures go to a screen, with a warning if it is doubtful. camera: the source."""
    render = config.render
    if not render.loop_ms or display not in ("window", "fullscreen"):
        return []
    doubt = loop_doubt(config, camera_name(camera) if camera else "", detect_monitors()[1])
    why = f"; doubtful: {doubt}; `lfpipe calibrate --latency` measures it" if doubt else ""
    return [f"loop    {render.loop_ms:g} ms delay of camera and display{why}"]
