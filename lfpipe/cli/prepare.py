"""The child process of `lfpipe up` that prepares its session: parses the arguments, checks the
machine without changing anything, then opens scenes and source.

`launch` starts it, again once the first scene is packed.
"""

import os
import tempfile
import threading
from pathlib import Path
from typing import Any

import attrs

from lfpipe import log
from lfpipe.capture.camera_list import NoCamera
from lfpipe.capture.open_source import (
    camera_name,
    camera_settings,
    check_devices,
    check_live,
    check_source,
    clock_of,
)
from lfpipe.capture.spec import is_live, parse_source, playing_once, source_file
from lfpipe.cli import machine_errors
from lfpipe.cli.sessions import Packed, SessionPlan, UpArguments
from lfpipe.cli.terminal import say
from lfpipe.config import Config, SessionOptions, converter, load
from lfpipe.config.check import has_key, with_measured_focal
from lfpipe.config.session_options import (
    CameraViewer,
    Live,
    MouseViewer,
    Nothing,
    NoViewer,
    RecordedEyes,
    Target,
    VideoFile,
    Viewer,
    Window,
    watching,
)
from lfpipe.errors import UserError, redacted
from lfpipe.files.codecs import require_encoder
from lfpipe.files.safe_files import check_output
from lfpipe.host.files import exists
from lfpipe.host.worker import Report, has_gpu, serve
from lfpipe.live.field import LiveViews, summary_of
from lfpipe.render.display.display import check_display, has_display, parse_display
from lfpipe.render.display.window_system import detect_monitors, device_latency_doubt
from lfpipe.render.plan import Plan, make_plan
from lfpipe.render.synthesis.compositor import settings_for_scene
from lfpipe.render.ui.settings import GLASSES
from lfpipe.scene.lightfield import HARDLY_FIT, LightField
from lfpipe.scene.pack import (
    DEMOS,
    Opened,
    PackerRequest,
    cache_dir,
    demo_scene,
    find_packed,
    open_pack,
    recent_scenes,
    remember_scene,
    summarize,
)
from lfpipe.supervisor.process_table import SCORER
from lfpipe.track import models

DEMO_S = 5.0  # length of the demo without a screen: the head moves to both sides
DEMO_FOLDER = Path("lfpipe-demo")


@attrs.frozen(kw_only=True)
class Request:
    """The request of the arguments and settings."""

    config: Config
    display: Target
    source: str
    """The source of frames; "" for the first camera."""
    duration_s: float | None
    still: Path | None = None
    """The last picture of the demo, which records itself where there is no screen."""

    @property
    def video(self) -> Path | None:
        """The file that pictures go to."""
        return self.display.path if isinstance(self.display, VideoFile) else None


def prepare(arguments: UpArguments, packed: Packed | None = None) -> dict[str, Any]:
    """The answer: "plan", a `SessionPlan` with a checked source; or "to_pack", a `PackerRequest`,
    and "complete", whether to wait for the disparity. packed: the result of that.

    Raises UserError.
    """
    if arguments.start:
        arguments = _with_recent_scenes(arguments)
    request = parse(arguments, has_screen=has_display())
    check(arguments, request)
    if arguments.no_picture:
        return {"plan": _open_source(arguments, request)}
    return _open(arguments, request, packed)


def _with_recent_scenes(arguments: UpArguments) -> UpArguments:
    """A session that begins with thumbnails of the demo and of recent scenes, with the mouse if
    there is no camera.
    """
    config = load()
    camera = None
    try:
        check_source(config.camera.source, camera_settings(config))
    except UserError as error:
        say(f"the mouse looks instead of a camera: {error.message}")
        camera = MouseViewer.source
    demos = [demo_scene(cache_dir(config.scene), name=name) for name in DEMOS]
    own = {demo.resolve() for demo in demos}
    scenes = (*demos, *(scene for scene in recent_scenes() if scene not in own))
    return attrs.evolve(arguments, camera=camera, scenes=scenes)


def parse(arguments: UpArguments, has_screen: bool) -> Request:
    """Raises UserError for errors that do not depend on the machine."""
    if arguments.no_picture:
        texts = {
            "SCENE": arguments.scenes,
            "--display": arguments.display,
            "--trace": arguments.trace,
        }
        if pointless := [name for name, value in texts.items() if value]:
            raise UserError(
                f"--no-picture with {', '.join(pointless)}: nothing is shown",
                "leave out one or the other",
            )
    elif not arguments.scenes and not arguments.demo:
        raise UserError(
            "no SCENE given", "name a folder of views, or use --demo for the built-in scene"
        )
    shows = not arguments.no_picture
    records_itself = shows and arguments.demo and arguments.display is None and not has_screen
    slower = ("render.rate_hz=30",) if records_itself else ()  # for a small video
    config = load(arguments.config_file, (*slower, *arguments.sets))
    folder = _demo_folder() if records_itself else DEMO_FOLDER
    if records_itself:
        display: Target = VideoFile(folder / _demo_video_name())
    else:
        display = parse_display(arguments.display or "window") if shows else Nothing()
    if isinstance(display, Window):
        display = attrs.evolve(
            display,
            lock_code=arguments.lock_code,
            every_s=arguments.every_s,
            title=arguments.title,
        )
    source = arguments.camera or config.camera.source or ("demo" if arguments.demo else "")
    if source and source != MouseViewer.source:
        parse_source(source)
    return Request(
        config=config,
        display=display,
        source=source,
        duration_s=arguments.duration_s or (DEMO_S if records_itself else None),
        still=folder / "demo.png" if records_itself else None,
    )


def _demo_folder() -> Path:
    """Where the demo records itself: a temporary folder if the working directory is read-only."""
    if os.access(DEMO_FOLDER if exists(DEMO_FOLDER) else Path(), os.W_OK):
        return DEMO_FOLDER
    return Path(tempfile.mkdtemp(prefix="lfpipe-demo-"))


def _demo_video_name() -> str:
    """The smallest video if there is an encoder for it; the other one plays anywhere, too."""
    try:
        require_encoder()
    except UserError:  # PyAV is not installed
        return "demo.avi"
    return "demo.mp4"


def check(arguments: UpArguments, request: Request) -> None:
    """Checks outputs and display without changing anything. Raises UserError."""
    files = (scene for scene in arguments.scenes if not is_live(scene))
    inputs = [path for path in (*files, source_file(request.source)) if path is not None]
    video, trace = request.video, arguments.trace
    if video is not None and request.still is None:  # in a folder of the user
        check_output(video, inputs, arguments.overwrite, "--display")
    if trace is not None:
        written = [] if video is None else [video]
        check_output(trace, [*inputs, *written], arguments.overwrite, "--trace")
    check_display(request.display)


def _open_source(arguments: UpArguments, request: Request) -> SessionPlan:
    """A session that tracks eyes and shows nothing."""
    viewer = _viewer(arguments, request)
    config = _completed(request.config, viewer)
    camera = (
        f"eyes\tfrom {viewer.source}, found by {config.track.engine}, filter"
        f" {config.track.filter}; no picture is shown"
    )
    options = SessionOptions(
        viewer=viewer, clock=clock_of(viewer.source), show=False, extras=arguments.extras
    )
    return SessionPlan(
        config=config,
        options=options,
        duration_s=request.duration_s,
        lines=(camera, *_extra_lines(arguments)),
    )


def _open(arguments: UpArguments, request: Request, packed: Packed | None) -> dict[str, Any]:
    """A session that shows scenes: packs the first unless it is packed, or captured now."""
    if any(map(is_live, arguments.scenes)):
        return {"plan": _open_live(arguments, request)}
    settings = request.config.scene
    if packed is not None:
        scenes, pack = packed
        opened = Opened([*map(Path, scenes)], open_pack(Path(pack), settings.invert_depth))
    else:
        scene = find_packed(arguments.scenes, settings, scorer=SCORER)
        if isinstance(scene, PackerRequest):
            return {"to_pack": scene, "complete": request.video is not None}
        opened = scene
    return {"plan": _open_packed(arguments, request, opened)}


def _open_live(arguments: UpArguments, request: Request) -> SessionPlan:
    """A session that shows a scene while it is captured."""
    text = str(arguments.scenes[0])
    if len(arguments.scenes) > 1:
        raise UserError(f"{text} with other scenes", f"show it alone: `lfpipe up {text}`")
    live = check_live(text, request.config)
    viewer = _viewer(arguments, request)
    check_devices(text, live, viewer)
    name = redacted(live.source)
    field = LiveViews(live, name).field
    return _plan(arguments, request, field, viewer, scene=summary_of(live, name), live=live)


def _open_packed(arguments: UpArguments, request: Request, opened: Opened) -> SessionPlan:
    scenes = opened.scenes
    scene = summarize(opened.field)
    viewer = _watching(arguments, request, opened, scene.needs_eyes)
    if request.still is not None:
        folder = request.still.parent
        folder.mkdir(exist_ok=True)
        say(f"no screen here: the demo records itself in {folder}/")
    if arguments.scenes and not (arguments.lock_code or arguments.start or arguments.calibrate_mm):
        remember_scene(scenes[0])
    is_camera = isinstance(viewer, CameraViewer | RecordedEyes) and viewer.source
    return _plan(
        arguments,
        request,
        opened.field,
        viewer,
        scene=scene,
        clock=clock_of(viewer.source) if is_camera else Live(),
        playlist=tuple(str(path.resolve()) for path in scenes),
    )


def _plan(
    arguments: UpArguments, request: Request, field: LightField, viewer: Viewer, **more: Any
) -> SessionPlan:
    """A session that shows pictures. more: options, as in `SessionOptions`."""
    display = request.display
    config = _completed(request.config, viewer)
    options = SessionOptions(
        viewer=viewer,
        display=display,
        start=arguments.start,
        calibrate_mm=arguments.calibrate_mm,
        ask_glasses=_is_first_start(arguments, display),
        trace=str(arguments.trace.resolve()) if arguments.trace else "",
        still=str(request.still.resolve()) if request.still else "",
        extras=arguments.extras,
        **more,
    )
    lines = [
        *startup_lines(config, field, make_plan(field, config), viewer, display),
        *device_latency_lines(config, viewer, display),
        *_extra_lines(arguments),
    ]
    if len(options.playlist) > 1:
        keys = "" if arguments.lock_code else ": Page Up, Page Down, Tab"
        lines.append(f"scenes\t{len(options.playlist)}{keys}")
    return SessionPlan(
        config=config,
        options=options,
        duration_s=request.duration_s,
        lines=tuple(lines),
        files=tuple(filter(None, (request.video, request.still, arguments.trace))),
    )


def _extra_lines(arguments: UpArguments) -> list[str]:
    return [f"{name}\t{text}" for name, texts in arguments.extras.items() for text in texts]


def _watching(arguments: UpArguments, request: Request, opened: Opened, needs_eyes: bool) -> Viewer:
    """The viewer of scenes. Raises UserError."""
    if not needs_eyes and len(opened.scenes) == 1:
        if not arguments.extras:
            return NoViewer()
        name = next(iter(arguments.extras))
        raise UserError(
            f"--{name} with {opened.scenes[0]}: its picture needs no eyes, so none are tracked",
            "use `lfpipe up --no-picture` to track without a scene",
        )
    return watching(_viewer(arguments, request), needs_eyes)


def _completed(config: Config, viewer: Viewer) -> Config:
    """The configuration with what is known of the camera, and with an engine that this machine has.
    Raises UserError.
    """
    if viewer.source and isinstance(viewer, CameraViewer | RecordedEyes):
        config = with_measured_focal(config, camera_name(viewer.source))
    return with_engine(config) if viewer.tracked else config


def _is_first_start(arguments: UpArguments, display: Target) -> bool:
    """Whether the user opens a window for the first time: no glasses are chosen, and no argument
    suggests a script.
    """
    scripted = (
        arguments.sets
        or arguments.config_file
        or arguments.duration_s
        or arguments.trace
        or arguments.lock_code
    )
    return not scripted and isinstance(display, Window) and not has_key("render", "anaglyph")


def with_engine(config: Config) -> Config:
    """Returns config with an engine that this machine has.

    Fetches its networks if they are missing. Raises UserError.
    """
    if config.track.engine == "mediapipe" and not models.has_face_mesh():
        say(
            f"engine  mediapipe has no FaceMesh here ({models.PACKAGE} has): using"
            " track.engine=litert, which runs the same landmark network"
        )
        config = attrs.evolve(config, track=attrs.evolve(config.track, engine="litert"))
    if config.track.engine == "litert" and models.missing_models():
        models.fetch_models(say)
    return config


def _viewer(arguments: UpArguments, request: Request) -> Viewer:
    """The viewer in front of the source. Without a camera, the mouse over a window that is not
    locked. A file whose pictures go to a file plays once. Raises UserError.
    """
    camera, display = request.source, request.display
    has_mouse = isinstance(display, Window) and not display.lock_code
    if camera == MouseViewer.source:
        if has_mouse:
            return MouseViewer()
        where = "a locked window" if isinstance(display, Window) else f"--display {display}"
        raise UserError(
            f"--camera mouse with {where}: there is no mouse",
            "use --display window, or another source: --camera demo",
        )
    try:
        once = playing_once(camera) if camera and request.video is not None else camera
        return check_source(once, camera_settings(request.config))
    except UserError as error:
        if arguments.wait_for_camera and (not camera or parse_source(camera).live):
            say(f"{error.message}; the session waits for its camera")
            return CameraViewer(source=camera)
        if not (has_mouse and isinstance(error, NoCamera)) or arguments.calibrate_mm:
            raise
        say("no camera: move the mouse to look around")
        return MouseViewer()


def startup_lines(
    config: Config, field: LightField, plan: Plan, viewer: Viewer, display: Target
) -> list[str]:
    """Scene, plan, camera and picture."""
    render = settings_for_scene(field, plan.method, config.render)
    clock = (
        f"at {render.nominal_hz:g} Hz" if render.clock == "display" else "for every camera frame"
    )
    if isinstance(display, Window):
        where = "on the whole screen" if display.fullscreen else "in a window"
        if render.clock == "display" and render.rate_hz == "auto":
            clock = "at every refresh"
        by = "" if has_gpu() else ", drawn by the CPU (no GPU found)"
    else:
        where, by = "not shown" if isinstance(display, Nothing) else f"to {display}", ""
    glasses = "without glasses" if render.anaglyph == "mono" else f"for {GLASSES[render.anaglyph]}"
    if not plan.needs_tracking:
        eyes = "not needed: the picture is the same from everywhere"
    elif isinstance(viewer, MouseViewer):
        eyes = "the mouse: move it to look around"
    else:
        eyes = viewer.source or "the first camera"
        eyes = "recorded face" if eyes.startswith("demo") else eyes
    lines = [
        (
            f"scene\t{field.name}: {field.rows}x{field.cols} views of"
            f" {field.width_px}x{field.height_px} pixels"
        ),
        f"picture\t{glasses} {where}, {clock}{by}",
        f"eyes\t{eyes}",
    ]
    if plan.needs_tracking and field.folder and not field.complete:
        lines.append("depth\tmeasuring disparity; until then, views are cross-faded")
    if HARDLY_FIT in field.manifest.notes:
        lines.append(f"note\t{HARDLY_FIT}")
    return lines


def device_latency_lines(config: Config, viewer: Viewer, display: Target) -> list[str]:
    """The device latency if pictures go to a screen, with a warning if it is doubtful."""
    render = config.render
    if (
        not render.device_latency_ms
        or not isinstance(display, Window)
        or isinstance(viewer, MouseViewer)
    ):
        return []
    doubt = device_latency_doubt(
        config, camera_name(viewer.source) if viewer.source else "", detect_monitors()[1]
    )
    why = f"; doubtful: {doubt}; `lfpipe calibrate --latency` measures it" if doubt else ""
    return [f"latency\t{render.device_latency_ms:g} ms of camera and display{why}"]


def work(request: dict[str, Any], report: Report) -> dict[str, Any]:
    """Reports {"plan": ...}, or {"to_pack": ..., "complete": ...}, and does not return: the parent
    ends this process once it holds the pack itself. Raises UserError.
    """
    log.set_up()
    with machine_errors():
        answer = prepare(
            converter().structure(request["arguments"], UpArguments), request["packed"]
        )
    report(**converter().unstructure(answer))
    threading.Event().wait()
    return {}


if __name__ == "__main__":
    serve(work, 1 << 40)  # without a limit
