"""`lfpipe up`, from its arguments to a running session.

`prepare` parses the arguments, checks the machine without changing anything, then opens scenes and
source; `launch` runs what it returns.
"""

import contextlib
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import attrs

from lfpipe import config as configuration
from lfpipe import log
from lfpipe.capture.camera_list import NoCamera
from lfpipe.capture.live_source import check_devices, check_live, is_live
from lfpipe.capture.open_source import camera_name, camera_settings, check_source, clock_of
from lfpipe.capture.spec import parse_source, playing_once, source_file
from lfpipe.cli.sessions import load_scene
from lfpipe.cli.terminal import filled, print_error, print_result, progress, say
from lfpipe.config import Config, SessionOptions
from lfpipe.config.modes import (
    CameraViewer,
    Clock,
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
from lfpipe.config.user_files import has_key, with_measured_focal
from lfpipe.errors import UserError, redacted
from lfpipe.files.output import check_outputs
from lfpipe.files.video_writer import require_encoder
from lfpipe.host.files import exists
from lfpipe.host.machine import has_gpu
from lfpipe.live.field import LiveViews, summary_of
from lfpipe.monitor.monitor import print_state
from lfpipe.monitor.session_reader import snapshot
from lfpipe.render.display.monitors import detect_monitors, device_latency_doubt
from lfpipe.render.display.open_display import check_display, has_display, parse_display
from lfpipe.render.plan import Plan, make_plan
from lfpipe.render.synthesis.compositor import settings_for_scene
from lfpipe.render.ui.notices import GLASSES
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.demo import NAMES, demo_scene
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.open_scene import Opened, Packing, open_scenes
from lfpipe.scene.pack import summarize
from lfpipe.scene.recent_scenes import recent_scenes, remember_scene
from lfpipe.supervisor import rundir
from lfpipe.supervisor.effects import Outcome
from lfpipe.supervisor.process_table import SCORER
from lfpipe.supervisor.supervisor import run_session
from lfpipe.track import models
from lfpipe.transport.session import Session, default_name

DEMO_S = 5.0  # length of the demo without a screen: the head moves to both sides
DEMO_FOLDER = Path("lfpipe-demo")


# (runs the first session, runs another one) -> exit code; each returns the exit code of a session
RunPolicy = Callable[[Callable[[], int], Callable[[], int]], int]


def first_alone(first: Callable[[], int], _another: Callable[[], int]) -> int:
    """Runs one session."""
    return first()


@attrs.frozen(kw_only=True)
class UpArguments:
    """The arguments of `lfpipe up`, and those that other packages add."""

    scenes: tuple[Path, ...] = ()
    camera: str | None = None
    display: str | None = None
    duration_s: float | None = None
    trace: Path | None = None
    demo: bool = False
    no_picture: bool = False
    session_name: str = attrs.field(factory=default_name)
    sets: tuple[str, ...] = ()
    config_file: str | None = None
    force: bool = False
    start: bool = False
    """Whether to begin with thumbnails of the scenes."""
    calibrate_mm: float = 0.0
    """Begins with the page that measures the camera, at this distance; 0: does not."""
    extras: Mapping[str, tuple[str, ...]] = attrs.field(factory=dict)
    """Options of stages of other packages, by stage. These stages need eyes."""
    lock_code: str = ""
    """The code that closes a locked window; "" if it is not locked."""
    every_s: float = 0.0
    """After so many seconds a locked window shows the next scene; 0: never."""
    wait_for_camera: bool = False
    """Whether the session starts without its camera, and waits for it."""
    run_policy: RunPolicy = first_alone
    """Whether sessions follow the first."""


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


@attrs.frozen(kw_only=True)
class SessionPlan:
    """A session that can start."""

    config: Config
    options: SessionOptions
    duration_s: float | None
    lines: tuple[str, ...]
    """The settings, for the user."""
    files: tuple[Path, ...] = ()
    """Its outputs, listed at its end."""
    hold: object = None
    """Keeps the pack in the cache."""
    packing: Packing | None = None
    """The packer, while it works on the scene's disparity."""


def start() -> int:
    """`lfpipe` without arguments on a desktop: a session that begins with thumbnails of the demo
    and of recent scenes, with the mouse if there is no camera. Returns the exit code.
    """
    config = configuration.load()
    camera = None
    try:
        check_source(config.camera.source, camera_settings(config))
    except UserError as error:
        say(f"the mouse looks instead of a camera: {error.message}")
        camera = MouseViewer.source
    demos = [demo_scene(cache_dir(config.scene), name=name) for name in NAMES]
    own = {demo.resolve() for demo in demos}
    scenes = (*demos, *(scene for scene in recent_scenes() if scene not in own))
    return launch(UpArguments(camera=camera, scenes=scenes, start=True))


def launch(arguments: UpArguments) -> int:
    """Runs a session; returns the exit code. Raises UserError before any process starts."""
    session = Session(arguments.session_name)
    if session.name in rundir.running():
        if _is_for_open_window(arguments):
            load_scene(session.name, arguments.scenes[0])
            say("shown in the open window; `--session NAME` opens another one")
            return 0
        rundir.release(session, rundir.acquire(session))  # raises the error with the remedy
    plan = prepare(arguments)
    return arguments.run_policy(
        lambda: _run(session, plan), lambda: _run(session, prepare(arguments))
    )


def _is_for_open_window(arguments: UpArguments) -> bool:
    """Whether one scene is asked for and nothing else, and the session that runs shows scenes in a
    window.
    """
    scenes = arguments.scenes
    name = arguments.session_name
    if (
        len(scenes) != 1
        or is_live(scenes[0])
        or arguments != UpArguments(scenes=scenes, session_name=name)
    ):
        return False
    options = snapshot(name).options
    return isinstance(options.display, Window) and not options.lock_code


def _run(session: Session, plan: SessionPlan) -> int:
    """Runs one session; returns the exit code.

    Raises UserError if the user can fix what ended it.
    """
    with contextlib.closing(plan.packing) if plan.packing is not None else contextlib.nullcontext():
        outcome = run_session(
            session, plan.config, plan.options, say, plan.duration_s, plan.packing
        )
    if outcome.final is not None and log.is_shown():
        print_state(outcome.final)
    for path in filter(exists, plan.files):
        print_result(f"{path.stat().st_size / 1e6:8.2f} MB  {path}")
    if outcome.failure is None:
        say(outcome.reason)
    return exit_code(outcome)


def exit_code(outcome: Outcome) -> int:
    """Returns 0, or 1 after printing what failed. Raises UserError if the user can fix it."""
    if outcome.failure is None:
        return 0
    if outcome.user_error:
        raise UserError(outcome.failure, outcome.remedy)
    print_error(UserError(outcome.failure, outcome.remedy))
    return 1


def prepare(arguments: UpArguments) -> SessionPlan:
    """A session that can start: its scene packed, its source checked. Prints its settings.

    Raises UserError.
    """
    request = parse(arguments, has_screen=has_display())
    check(arguments, request)
    plan = _open_source(arguments, request) if arguments.no_picture else _open(arguments, request)
    for line in plan.lines:
        head, _, text = line.partition("\t")
        say(filled(text, f"{head:<9}") if text else line)
    return plan


def parse(arguments: UpArguments, has_screen: bool) -> Request:
    """Raises UserError for errors that do not depend on the machine."""
    if arguments.no_picture:
        given = {
            "SCENE": arguments.scenes,
            "--display": arguments.display,
            "--trace": arguments.trace,
        }
        if pointless := [name for name, value in given.items() if value]:
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
    config = configuration.load(arguments.config_file, (*slower, *arguments.sets))
    folder = _demo_folder() if records_itself else DEMO_FOLDER
    if records_itself:
        display: Target = VideoFile(folder / _demo_video_name())
    else:
        display = parse_display(arguments.display or "window") if shows else Nothing()
    if isinstance(display, Window):
        display = attrs.evolve(display, lock_code=arguments.lock_code, every_s=arguments.every_s)
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
    inputs = (*files, source_file(request.source))
    own_folder = request.still is not None and not exists(request.still.parent)  # made later
    video = None if own_folder else request.video
    check_outputs(
        {"--display": video, "--trace": arguments.trace}, filter(None, inputs), arguments.force
    )
    check_display(request.display, str(request.config.screen.monitor))


def _open_source(arguments: UpArguments, request: Request) -> SessionPlan:
    """A session that tracks eyes and shows nothing."""
    viewer = _viewer(arguments, request)
    config = with_engine(with_measured_focal(request.config, camera_name(viewer.source)))
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


def _open(arguments: UpArguments, request: Request) -> SessionPlan:
    """A session that shows scenes: packs the first unless it is packed, or captured now."""
    if any(map(is_live, arguments.scenes)):
        return _open_live(arguments, request)
    with progress() as bar:
        opened = open_scenes(
            arguments.scenes,
            request.config.scene,
            bar,
            scorer=SCORER,
            complete=request.video is not None,
        )
    try:
        return _plan(arguments, request, opened)
    except BaseException:
        if opened.packing is not None:
            opened.packing.close()
        raise


def _open_live(arguments: UpArguments, request: Request) -> SessionPlan:
    """A session that shows a scene while it is captured."""
    text = str(arguments.scenes[0])
    if len(arguments.scenes) > 1:
        raise UserError(f"{text} with other scenes", f"show it alone: `lfpipe up {text}`")
    live = check_live(text, request.config)
    viewer = _viewer(arguments, request)
    check_devices(text, live, viewer.source)
    config = request.config
    if viewer.source and isinstance(viewer, CameraViewer | RecordedEyes):
        config = with_measured_focal(config, camera_name(viewer.source))
    if viewer.tracked:
        config = with_engine(config)
    display = request.display
    name = redacted(live.source)
    field = LiveViews(live, name).field
    return SessionPlan(
        config=config,
        options=SessionOptions(
            scene=summary_of(live, name),
            live=live,
            viewer=viewer,
            display=display,
            ask_glasses=_is_first_start(arguments, display),
            trace=str(arguments.trace.resolve()) if arguments.trace else "",
            extras=arguments.extras,
        ),
        duration_s=request.duration_s,
        lines=(
            *startup_lines(config, field, make_plan(field, config), viewer, display),
            *device_latency_lines(config, viewer, display),
            *_extra_lines(arguments),
        ),
        files=tuple(filter(None, (request.video, arguments.trace))),
    )


def _plan(arguments: UpArguments, request: Request, opened: Opened) -> SessionPlan:
    display = request.display
    scenes = opened.scenes
    scene = summarize(opened.field)
    config, viewer, clock = _watched(arguments, request, opened, scene.needs_eyes)
    lines = [
        *startup_lines(config, opened.field, make_plan(opened.field, config), viewer, display),
        *device_latency_lines(config, viewer, display),
        *_extra_lines(arguments),
    ]
    if len(scenes) > 1:
        keys = "" if arguments.lock_code else "Tab, Page Up and Page Down, or "
        command = f"lfpipe ctl --session {arguments.session_name} load --next"
        lines.append(f"scenes\t{len(scenes)}: {keys}`{command}` to show the others")
    if request.still is not None:
        folder = request.still.parent
        folder.mkdir(exist_ok=True)
        lines.insert(0, f"no screen here: the demo records itself in {folder}/")
    if arguments.scenes and not (arguments.lock_code or arguments.start or arguments.calibrate_mm):
        remember_scene(scenes[0])
    options = SessionOptions(
        scene=scene,
        viewer=viewer,
        clock=clock,
        display=display,
        playlist=(
            tuple(str(path.resolve()) for path in scenes)
            if len(scenes) > 1 or arguments.start
            else ()
        ),
        start=arguments.start,
        calibrate_mm=arguments.calibrate_mm,
        ask_glasses=_is_first_start(arguments, display),
        trace=str(arguments.trace.resolve()) if arguments.trace else "",
        still=str(request.still.resolve()) if request.still else "",
        extras=arguments.extras,
    )
    return SessionPlan(
        config=config,
        options=options,
        duration_s=request.duration_s,
        lines=tuple(lines),
        files=tuple(filter(None, (request.video, request.still, arguments.trace))),
        hold=opened.field.hold,
        packing=opened.packing,
    )


def _extra_lines(arguments: UpArguments) -> list[str]:
    return [f"{name}\t{text}" for name, texts in arguments.extras.items() for text in texts]


def _watched(
    arguments: UpArguments, request: Request, opened: Opened, needs_eyes: bool
) -> tuple[Config, Viewer, Clock]:
    """The configuration with what the machine and the camera lack or are known for, the viewer, and
    the clock. Raises UserError.
    """
    config = request.config
    if not needs_eyes and len(opened.scenes) == 1:
        if not arguments.extras:
            return config, NoViewer(), Live()
        name = next(iter(arguments.extras))
        raise UserError(
            f"--{name} with {opened.scenes[0]}: its picture needs no eyes, so none are tracked",
            "use `lfpipe up --no-picture` to track without a scene",
        )
    viewer = watching(_viewer(arguments, request), needs_eyes)
    clock: Clock = Live()
    if viewer.source and isinstance(viewer, CameraViewer | RecordedEyes):
        config = with_measured_focal(config, camera_name(viewer.source))
        clock = clock_of(viewer.source)
    return (with_engine(config) if viewer.tracked else config), viewer, clock


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
        config = attrs.evolve(
            config, track=attrs.evolve(config.track, engine="litert", refine=False)
        )
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
        name = viewer.source or "the first camera"
        eyes = f"from {name}, found by {config.track.engine}, filter {config.track.filter}"
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
