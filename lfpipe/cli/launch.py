"""`lfpipe up`, from its arguments to a running session. All checks run before the first process starts."""

import contextlib
from pathlib import Path

import attrs
import click

from lfpipe import config as configuration
from lfpipe.capture.open_source import BY_MOUSE, MOUSE, NoCamera, camera_name, check_source
from lfpipe.capture.spec import playing_once, source_file
from lfpipe.cli.kiosk import until_it_ends
from lfpipe.cli.progress import progress
from lfpipe.config import Config, SessionOptions
from lfpipe.config.user_files import has_key, with_measured_focal
from lfpipe.errors import UserError
from lfpipe.files.output import check_outputs
from lfpipe.files.video_writer import require_encoder
from lfpipe.host.files import exists
from lfpipe.host.machine import has_gpu
from lfpipe.observe.monitor import print_state
from lfpipe.render.compositor import mixed_as
from lfpipe.render.display import check_display, has_display
from lfpipe.render.geometry import parallax
from lfpipe.render.monitors import detect_monitors, loop_doubt
from lfpipe.render.plan import Plan, make_plan
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.demo import NAMES, demo_scene
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.open_scene import Packing, open_scenes
from lfpipe.scene.pack import summarize
from lfpipe.scene.recent_scenes import recent_scenes, remember_scene
from lfpipe.share.target import check_targets
from lfpipe.supervisor import rundir
from lfpipe.supervisor.live_session import Outcome
from lfpipe.supervisor.supervisor import run_session
from lfpipe.track import models
from lfpipe.transport.session import Session, default_name

DEMO_S = 10.0  # length of the demo without a screen
DEMO_FOLDER = Path("lfpipe-demo")
WINDOWS = ("window", "fullscreen")


@attrs.frozen
class UpArguments:
    """The arguments of `lfpipe up`. kiosk: the code that ends an exhibition. start: begin with the scenes' thumbnails."""

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


@attrs.frozen
class SessionPlan:
    """A session that can start. files: its outputs, listed at its end. hold: keeps the pack in the cache. packing: the packer,
    while it works on the scene's disparity."""

    config: Config
    options: SessionOptions
    duration_s: float | None
    files: tuple[Path, ...] = ()
    hold: object = None
    packing: Packing | None = None


def say(text: str) -> None:
    """Prints a line for people on stderr: stdout is for results."""
    click.echo(text, err=True)


def start() -> int:
    """`lfpipe` without arguments on a desktop: a session that begins with thumbnails of the demo and of recent scenes, with the
    demo's viewer if there is no camera. Returns the exit code."""
    config, camera = configuration.load(), None
    try:
        check_source(config.camera.source, config.camera)
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
        rundir.release(session, rundir.acquire(session))  # raises the error with the remedy
    plan = prepare(arguments)
    if arguments.kiosk is None:
        return _run(session, plan)
    return until_it_ends(lambda: _run(session, plan), lambda: _run(session, prepare(arguments)))


def _run(session: Session, plan: SessionPlan) -> int:
    """Runs one session; returns the exit code. Raises UserError if the user can fix what ended it."""
    with contextlib.closing(plan.packing) if plan.packing is not None else contextlib.nullcontext():
        outcome = run_session(
            session, plan.config, plan.options, say, plan.duration_s, plan.packing
        )
    print_state(outcome.final)
    for path in filter(exists, plan.files):
        click.echo(f"{path.stat().st_size / 1e6:8.2f} MB  {path}")
    if outcome.failure is None:
        say(outcome.reason)
    return exit_code(outcome)


def exit_code(outcome: Outcome) -> int:
    """Returns 0, or 1 after printing what failed. Raises UserError if the user can fix it."""
    if outcome.failure is None:
        return 0
    if outcome.user_error:
        raise UserError(outcome.failure, outcome.remedy)
    say(f"error: {outcome.failure}\n  remedy: {outcome.remedy}")
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
    camera = _source(arguments.source(config), "none", config, False)
    config = with_engine(with_measured_focal(config, camera_name(camera.source)))
    say(
        f"camera  {camera.source}; eyes by {config.track.engine}, filter {config.track.filter}; no picture"
    )
    for target in share:
        say(f"share   eyes and head to {target}")
    return SessionPlan(config, attrs.evolve(camera, show=False, share=share), arguments.duration_s)


def prepare(arguments: UpArguments) -> SessionPlan:
    """Checks all arguments, packs the scene unless it is packed, and prints the settings in force. Raises UserError."""
    if arguments.no_picture:
        return _prepare_tracking(arguments)
    if not arguments.scenes and not arguments.demo:
        raise UserError(
            "no SCENE given", "name a folder of views, or use --demo for the built-in scene"
        )
    is_kiosk = arguments.kiosk is not None
    records_itself = arguments.demo and arguments.display is None and not has_display()
    still = DEMO_FOLDER / "demo.png" if records_itself else None
    display = (
        _demo_display()
        if records_itself
        else arguments.display or ("fullscreen" if is_kiosk else "window")
    )
    video = (
        Path(display.removeprefix("file:")).expanduser() if display.startswith("file:") else None
    )
    if is_kiosk and display not in WINDOWS:
        raise UserError(
            f"--kiosk with --display {display}: an exhibition needs a screen",
            "leave out one or the other",
        )
    halved = ("render.rate_hz=30",) if records_itself else ()  # lossless video is large
    config = configuration.load(arguments.config_file, (*halved, *arguments.sets))
    source = arguments.source(config)
    inputs = [path for path in (*arguments.scenes, source_file(source)) if path is not None]
    check_outputs({"--display": video, "--trace": arguments.trace}, inputs, arguments.force)
    check_display(display, str(config.screen.monitor))
    share = check_targets(arguments.share)
    with progress() as bar:
        opened = open_scenes(arguments.scenes, config.scene, bar, complete=video is not None)
    try:
        scenes, scene = opened.scenes, summarize(opened.field)
        camera = SessionOptions()
        if scene.needs_tracking or len(scenes) > 1:
            camera = _source(source, display, config, is_kiosk)
        elif arguments.share:
            remedy = "`lfpipe up --no-picture --share TARGET` tracks without a scene"
            raise UserError(
                f"--share with {scenes[0]}: a single view needs no eyes, so none are tracked",
                remedy,
            )
        tracking = scene.needs_tracking and not camera.mouse
        if camera.source and not camera.mouse:
            config = with_measured_focal(config, camera_name(camera.source))
        config = with_engine(config) if tracking else config
    except BaseException:
        if opened.packing is not None:
            opened.packing.close()
        raise
    if arguments.scenes and not is_kiosk and not arguments.start:
        remember_scene(scenes[0])
    plan = make_plan(opened.field, config)
    for line in (
        *startup_lines(config, opened.field, plan, camera.source, display),
        *loop_lines(config, camera.source, display),
    ):
        say(line)
    for target in share:
        say(f"share   eyes and head to {target}")
    if len(scenes) > 1:
        say(
            f"scenes  {len(scenes)}: Tab, Page Up and Page Down show the others, as does `lfpipe ctl load --next`"
        )
    options = attrs.evolve(
        camera,
        scene=scene,
        tracking=tracking,
        display=display,
        kiosk=arguments.kiosk or "",
        playlist=tuple(str(path.resolve()) for path in scenes)
        if len(scenes) > 1 or arguments.start
        else (),
        start=arguments.start,
        ask_glasses=_is_first_start(arguments, display),
        trace=str(arguments.trace.resolve()) if arguments.trace else "",
        still=str(still.resolve()) if still else "",
        share=share,
    )
    files = tuple(path for path in (video, still, arguments.trace) if path is not None)
    duration_s = arguments.duration_s or (DEMO_S if records_itself else None)
    return SessionPlan(config, options, duration_s, files, opened.field.hold, opened.packing)


def _demo_display() -> str:
    """Creates the folder to which the demo records itself without a screen. Returns its video as a display: small and playable
    anywhere if there is an encoder for that. Raises OSError."""
    DEMO_FOLDER.mkdir(exist_ok=True)
    say(f"no screen here: the demo records itself in {DEMO_FOLDER}/")
    try:
        require_encoder()
    except UserError as error:
        say(f"the demo's video is lossless and large: {error.message}; {error.remedy}")
        return f"file:{DEMO_FOLDER / 'demo.mkv'}"
    return f"file:{DEMO_FOLDER / 'demo.mp4'}"


def _is_first_start(arguments: UpArguments, display: str) -> bool:
    """Whether a person opens a window for the first time: no glasses were chosen yet, and nothing is given as scripts do."""
    scripted = (
        arguments.sets
        or arguments.config_file
        or arguments.duration_s
        or arguments.trace
        or arguments.kiosk is not None
    )
    return not scripted and display in WINDOWS and not has_key("render", "anaglyph")


def with_engine(config: Config) -> Config:
    """Returns config with an engine that this machine has. Fetches its networks if they are missing. Raises UserError."""
    if config.track.engine == "mediapipe" and models.package_folder() is None:
        say(
            "engine  mediapipe is not installed here: using track.engine=litert, which runs the same landmark network"
        )
        config = attrs.evolve(config, track=attrs.evolve(config.track, engine="litert"))
    if config.track.engine == "litert" and models.missing_models():
        models.fetch_models(say)
    return config


def _source(camera: str, display: str, config: Config, kiosk: bool) -> SessionOptions:
    """The source of frames; without a camera, the mouse over a window, but not in an exhibition, which has none. A file whose
    pictures go to a file plays once. Raises UserError."""
    has_mouse = display in WINDOWS and not kiosk
    if camera == MOUSE and not has_mouse:
        where = "--kiosk" if kiosk else f"--display {display}"
        remedy = "use --display window, or another source: --camera demo"
        raise UserError(f"--camera mouse with {where}: there is no mouse", remedy)
    try:
        once = playing_once(camera) if camera and display.startswith("file:") else camera
        return BY_MOUSE if camera == MOUSE else check_source(once, config.camera)
    except NoCamera:
        if not has_mouse:
            raise
        say("no camera: move the mouse to look around")
        return BY_MOUSE


def startup_lines(
    config: Config, field: LightField, plan: Plan, camera: str, display: str
) -> list[str]:
    """Scene, plan, camera, alpha and picture. camera: the source. display: as for `--display`."""
    without = ", ".join(item.what for item in plan.left_out)
    left_out = f"; left out: {without} (`lfpipe scene plan` explains why)" if without else ""
    render = mixed_as(field, plan.method, config.render)
    on_screen = display in WINDOWS
    at_hz = (
        "of the screen"
        if on_screen and render.rate_hz == "auto"
        else f"at {render.nominal_hz:g} Hz"
    )
    clock = f"every refresh {at_hz}" if render.clock == "display" else "every camera frame"
    by = ", drawn by the CPU (no GPU found)" if on_screen and not has_gpu() else ""
    if not plan.needs_tracking:
        source, alpha = "none: a single view needs no eyes", "none: the scene has one view"
    else:
        source = f"{camera}; eyes by {config.track.engine}, filter {config.track.filter}"
        source = (
            "none, and no tracking: move the mouse to look around" if camera == MOUSE else source
        )
        chosen = parallax(config, field, config.camera.frame_px[0], None)
        depth = "" if chosen.compression is None else f", {chosen.compression:.0%} of true depth"
        across = f"{field.cols} columns" if field.cols > 1 else f"{field.rows} rows"
        asked = (
            "set"
            if isinstance(render.alpha_px, float)
            else f"{render.alpha_px}, at {chosen.distance_mm:.0f} mm"
        )
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
    if not render.loop_ms or display not in WINDOWS or camera == MOUSE:
        return []
    doubt = loop_doubt(config, camera_name(camera) if camera else "", detect_monitors()[1])
    why = f"; doubtful: {doubt}; `lfpipe calibrate --latency` measures it" if doubt else ""
    return [f"loop    {render.loop_ms:g} ms delay of camera and display{why}"]
