"""`lfpipe up`, from its arguments to a running session.

All checks run before the first process starts.
"""

import contextlib
from pathlib import Path

import attrs

from lfpipe import config as configuration
from lfpipe.capture.camera_list import NoCamera
from lfpipe.capture.open_source import camera_name, camera_settings, check_source, clock_of
from lfpipe.capture.spec import CameraSpec, parse_source, playing_once, source_file
from lfpipe.cli.sessions import load_scene
from lfpipe.cli.terminal import print_error, print_result, progress, say
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
from lfpipe.errors import UserError
from lfpipe.extras.exhibition.kiosk import until_it_ends
from lfpipe.extras.share.target import check_targets
from lfpipe.files.output import check_outputs
from lfpipe.files.video_writer import require_encoder
from lfpipe.host.files import exists
from lfpipe.host.machine import has_gpu
from lfpipe.monitor.monitor import print_state
from lfpipe.monitor.session_reader import snapshot
from lfpipe.render.display.monitors import detect_monitors, device_latency_doubt
from lfpipe.render.display.open_display import check_display, has_display, parse_display
from lfpipe.render.plan import Plan, make_plan
from lfpipe.render.synthesis.compositor import settings_for_scene
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

DEMO_S = 10.0  # length of the demo without a screen
DEMO_FOLDER = Path("lfpipe-demo")


@attrs.frozen(kw_only=True)
class UpArguments:
    """The arguments of `lfpipe up`.

    kiosk: the code that ends an exhibition. start: begin with the scenes' thumbnails.
    """

    scenes: tuple[Path, ...] = ()
    camera: str | None = None
    display: str | None = None
    duration_s: float | None = None
    trace: Path | None = None
    demo: bool = False
    share: tuple[str, ...] = ()
    no_picture: bool = False
    session_name: str = attrs.field(factory=default_name)
    sets: tuple[str, ...] = ()
    config_file: str | None = None
    kiosk: str | None = None
    start: bool = False
    force: bool = False

    def source(self, config: Config) -> str:
        """The source of frames that is asked for; empty for the first camera."""
        return self.camera or config.camera.source or ("demo" if self.demo else "")


@attrs.frozen(kw_only=True)
class SessionPlan:
    """A session that can start. files: its outputs, listed at its end. hold: keeps the pack in the
    cache. packing: the packer, while it works on the scene's disparity.
    """

    config: Config
    options: SessionOptions
    duration_s: float | None
    files: tuple[Path, ...] = ()
    hold: object = None
    packing: Packing | None = None


def start() -> int:
    """`lfpipe` without arguments on a desktop: a session that begins with thumbnails of the demo
    and of recent scenes, with the demo's viewer if there is no camera. Returns the exit code.
    """
    config = configuration.load()
    camera = None
    try:
        check_source(config.camera.source, camera_settings(config))
    except UserError as error:
        say(f"using the demo's face instead of a camera: {error.message}")
        camera = "demo"
    demos = [demo_scene(cache_dir(config.scene), name=name) for name in NAMES]
    own = {demo.resolve() for demo in demos}
    scenes = (*demos, *(scene for scene in recent_scenes() if scene not in own))
    return launch(UpArguments(camera=camera, scenes=scenes, start=True))


def launch(arguments: UpArguments) -> int:
    """Runs a session; returns the exit code. Raises UserError before any process starts.

    An exhibition that fails after it has run restarts until it succeeds: it has no operator.
    """
    session = Session(arguments.session_name)
    if session.name in rundir.running():
        if _is_for_open_window(arguments):
            load_scene(session.name, arguments.scenes[0])
            say("shown in the open window; `--session NAME` opens another one")
            return 0
        rundir.release(session, rundir.acquire(session))  # raises the error with the remedy
    plan = prepare(arguments)
    if arguments.kiosk is None:
        return _run(session, plan)
    return until_it_ends(lambda: _run(session, plan), lambda: _run(session, prepare(arguments)))


def _is_for_open_window(arguments: UpArguments) -> bool:
    """Whether one scene is asked for and nothing else, and the session that runs shows scenes in a
    window.
    """
    scenes = arguments.scenes
    name = arguments.session_name
    if len(scenes) != 1 or arguments != UpArguments(scenes=scenes, session_name=name):
        return False
    options = snapshot(name).options
    return isinstance(options.display, Window) and not options.kiosk


def _run(session: Session, plan: SessionPlan) -> int:
    """Runs one session; returns the exit code.

    Raises UserError if the user can fix what ended it.
    """
    with contextlib.closing(plan.packing) if plan.packing is not None else contextlib.nullcontext():
        outcome = run_session(
            session, plan.config, plan.options, say, plan.duration_s, plan.packing
        )
    if outcome.final is not None:
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


def _prepare_tracking(arguments: UpArguments) -> SessionPlan:
    """A session that tracks eyes and shows nothing."""
    given = {"SCENE": arguments.scenes, "--display": arguments.display, "--trace": arguments.trace}
    if pointless := [name for name, value in given.items() if value]:
        raise UserError(
            f"--no-picture with {', '.join(pointless)}: nothing is shown",
            "leave out one or the other",
        )
    config = configuration.load(arguments.config_file, arguments.sets)
    share = check_targets(arguments.share)
    viewer = _viewer(arguments.source(config), Nothing(), config)
    config = with_engine(with_measured_focal(config, camera_name(viewer.source)))
    say(
        f"camera  {viewer.source}; eyes by {config.track.engine}, filter {config.track.filter}; no"
        " picture"
    )
    for target in share:
        say(f"share   eyes and head to {target}")
    options = SessionOptions(viewer=viewer, clock=clock_of(viewer.source), show=False, share=share)
    return SessionPlan(config=config, options=options, duration_s=arguments.duration_s)


def prepare(arguments: UpArguments) -> SessionPlan:
    """Checks all arguments, packs the scene unless it is packed, and prints the settings in force.

    Raises UserError.
    """
    if arguments.no_picture:
        return _prepare_tracking(arguments)
    if not arguments.scenes and not arguments.demo:
        raise UserError(
            "no SCENE given", "name a folder of views, or use --demo for the built-in scene"
        )
    is_kiosk = arguments.kiosk is not None
    records_itself = arguments.demo and arguments.display is None and not has_display()
    still = DEMO_FOLDER / "demo.png" if records_itself else None
    display = VideoFile(_demo_video()) if records_itself else _display(arguments)
    video = display.path if isinstance(display, VideoFile) else None
    halved = ("render.rate_hz=30",) if records_itself else ()  # for a small video
    config = configuration.load(arguments.config_file, (*halved, *arguments.sets))
    inputs = (*arguments.scenes, source_file(arguments.source(config)))
    check_outputs(
        {"--display": video, "--trace": arguments.trace}, filter(None, inputs), arguments.force
    )
    check_display(display, str(config.screen.monitor))
    share = check_targets(arguments.share)
    with progress() as bar:
        opened = open_scenes(
            arguments.scenes, config.scene, bar, scorer=SCORER, complete=video is not None
        )
    try:
        scene = summarize(opened.field)
        config, viewer, clock = _watched(arguments, opened, scene.needs_eyes, display, config)
    except BaseException:
        if opened.packing is not None:
            opened.packing.close()
        raise
    scenes = opened.scenes
    if arguments.scenes and not is_kiosk and not arguments.start:
        remember_scene(scenes[0])
    plan = make_plan(opened.field, config)
    for line in (
        *startup_lines(config, opened.field, plan, viewer, display),
        *device_latency_lines(config, viewer, display),
    ):
        say(line)
    for target in share:
        say(f"share   eyes and head to {target}")
    if len(scenes) > 1:
        keys = "" if is_kiosk else "Tab, Page Up and Page Down, or "
        command = f"lfpipe ctl --session {arguments.session_name} load --next"
        say(f"scenes  {len(scenes)}: {keys}`{command}` to show the others")
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
        ask_glasses=_is_first_start(arguments, display),
        trace=str(arguments.trace.resolve()) if arguments.trace else "",
        still=str(still.resolve()) if still else "",
        share=share,
    )
    return SessionPlan(
        config=config,
        options=options,
        duration_s=arguments.duration_s or (DEMO_S if records_itself else None),
        files=tuple(path for path in (video, still, arguments.trace) if path is not None),
        hold=opened.field.hold,
        packing=opened.packing,
    )


def _watched(
    arguments: UpArguments, opened: Opened, needs_eyes: bool, display: Target, config: Config
) -> tuple[Config, Viewer, Clock]:
    """Who looks at the scenes, by which clock, and the configuration with what the machine and the
    camera lack or are known for. Raises UserError.
    """
    if not needs_eyes and len(opened.scenes) == 1:
        if not arguments.share:
            return config, NoViewer(), Live()
        raise UserError(
            f"--share with {opened.scenes[0]}: its picture needs no eyes, so none are tracked",
            "track without a scene: `lfpipe up --no-picture --share TARGET`",
        )
    viewer = watching(_viewer(arguments.source(config), display, config), needs_eyes)
    clock: Clock = Live()
    if viewer.source and isinstance(viewer, CameraViewer | RecordedEyes):
        config = with_measured_focal(config, camera_name(viewer.source))
        clock = clock_of(viewer.source)
    return (with_engine(config) if viewer.tracked else config), viewer, clock


def _display(arguments: UpArguments) -> Target:
    """The display that is asked for; an exhibition fills the screen. Raises UserError."""
    if arguments.kiosk is None:
        return parse_display(arguments.display or "window")
    display = parse_display(arguments.display or "fullscreen")
    if not isinstance(display, Window):
        raise UserError(
            f"--kiosk with --display {display}: an exhibition needs a screen",
            "leave out one or the other",
        )
    return attrs.evolve(display, kiosk=arguments.kiosk)


def _demo_video() -> Path:
    """Creates the folder to which the demo records itself without a screen. Returns the path of its
    video, which plays anywhere: the smallest if there is an encoder for that. Raises OSError.
    """
    DEMO_FOLDER.mkdir(exist_ok=True)
    say(f"no screen here: the demo records itself in {DEMO_FOLDER}/")
    try:
        require_encoder()
    except UserError:  # PyAV is not installed
        return DEMO_FOLDER / "demo.avi"
    return DEMO_FOLDER / "demo.mp4"


def _is_first_start(arguments: UpArguments, display: Target) -> bool:
    """Whether a person opens a window for the first time: no glasses were chosen yet, and nothing
    is given as scripts do.
    """
    scripted = (
        arguments.sets
        or arguments.config_file
        or arguments.duration_s
        or arguments.trace
        or arguments.kiosk is not None
    )
    return not scripted and isinstance(display, Window) and not has_key("render", "anaglyph")


def with_engine(config: Config) -> Config:
    """Returns config with an engine that this machine has.

    Fetches its networks if they are missing. Raises UserError.
    """
    if config.track.engine == "mediapipe" and models.package_folder() is None:
        say(
            "engine  mediapipe is not installed here: using track.engine=litert, which runs the"
            " same landmark network"
        )
        config = attrs.evolve(config, track=attrs.evolve(config.track, engine="litert"))
    if config.track.engine == "litert" and models.missing_models():
        models.fetch_models(say)
    return config


def _viewer(camera: str, display: Target, config: Config) -> Viewer:
    """The viewer in front of a source. Without a camera, the mouse over a window; an exhibition
    waits for its camera. A file whose pictures go to a file plays once. Raises UserError.
    """
    is_exhibition = isinstance(display, Window) and bool(display.kiosk)
    has_mouse = isinstance(display, Window) and not is_exhibition
    if camera == MouseViewer.source and not has_mouse:
        where = "--kiosk" if is_exhibition else f"--display {display}"
        raise UserError(
            f"--camera mouse with {where}: there is no mouse",
            "use --display window, or another source: --camera demo",
        )
    try:
        once = playing_once(camera) if camera and isinstance(display, VideoFile) else camera
        if camera == MouseViewer.source:
            return MouseViewer()
        return check_source(once, camera_settings(config))
    except UserError as error:
        if is_exhibition and (not camera or isinstance(parse_source(camera), CameraSpec)):
            say(f"{error.message}; the exhibition waits for its camera")
            return CameraViewer(source=camera)
        if not (has_mouse and isinstance(error, NoCamera)):
            raise
        say("no camera: move the mouse to look around")
        return MouseViewer()


def startup_lines(
    config: Config, field: LightField, plan: Plan, viewer: Viewer, display: Target
) -> list[str]:
    """Scene, plan, camera and picture."""
    without = ", ".join(item.what for item in plan.left_out)
    left_out = f"; left out: {without} (`lfpipe scene plan` explains why)" if without else ""
    render = settings_for_scene(field, plan.method, config.render)
    on_screen = isinstance(display, Window)
    at_hz = (
        "of the screen"
        if on_screen and render.rate_hz == "auto"
        else f"at {render.nominal_hz:g} Hz"
    )
    clock = f"every refresh {at_hz}" if render.clock == "display" else "every camera frame"
    by = ", drawn by the CPU (no GPU found)" if on_screen and not has_gpu() else ""
    if not plan.needs_tracking:
        source = "none: the picture needs no eyes"
    elif isinstance(viewer, MouseViewer):
        source = "none, and no tracking: move the mouse to look around"
    else:
        name = viewer.source or "the first one"
        source = f"{name}; eyes by {config.track.engine}, filter {config.track.filter}"
    return [
        (
            f"scene   {field.name}: {field.rows}x{field.cols} views of"
            f" {field.width_px}x{field.height_px}"
        ),
        f"plan    views by {plan.method}{left_out}",
        f"camera  {source}",
        f"picture {render.anaglyph} in {render.light} light, {clock}, to {display}{by}",
    ]


def device_latency_lines(config: Config, viewer: Viewer, display: Target) -> list[str]:
    """The delay of the loop if pictures go to a screen, with a warning if it is doubtful."""
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
    return [f"loop    {render.device_latency_ms:g} ms delay of camera and display{why}"]
