"""Commands of sessions: `lfpipe up`, from its arguments to the end of its session, and to running
ones `monitor`, `ctl` and `trace`. Scripts ask often: what an answer alone does not need is imported
where it is used.

The process of `up` becomes the session's supervisor, so it imports neither OpenCV nor a toolkit: a
child process, `prepare`, checks the arguments and the machine, and opens scenes and source.
"""

import contextlib
import itertools
import json
import os
import subprocess
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import click

from lfpipe import config as configuration
from lfpipe import log
from lfpipe.capture.spec import is_live
from lfpipe.cli.terminal import (
    DURATION,
    OVERWRITE,
    PATH,
    SESSION,
    ExtensibleGroup,
    Group,
    filled,
    print_error,
    print_result,
    progress,
    say,
    with_settings,
)
from lfpipe.config import Config, SessionOptions, converter, parse_set
from lfpipe.config.session_options import Window
from lfpipe.errors import UserError
from lfpipe.host.files import exists
from lfpipe.host.worker import Worker, python
from lfpipe.supervisor import rundir
from lfpipe.supervisor.rundir import ask
from lfpipe.transport.control import (
    FILE_CHECK_TIMEOUT_S,
    LOAD_TIMEOUT_S,
    Message,
    Session,
    default_name,
)

if TYPE_CHECKING:
    from lfpipe.scene.pack import Packing
    from lfpipe.supervisor.session import Outcome

PREPARER = "lfpipe.cli.prepare"  # the child's module
# (runs the first session, runs another one) -> exit code; each returns the exit code of a session
RunPolicy = Callable[[Callable[[], int], Callable[[], int]], int]


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
    overwrite: bool = False
    start: bool = False
    """Whether to begin with thumbnails of the demo and of recent scenes."""
    calibrate_mm: float = 0.0
    """Begins with the page that measures the camera, at this distance; 0: does not."""
    extras: Mapping[str, tuple[str, ...]] = attrs.field(factory=dict)
    """Options of stages of other packages, by stage. These stages need eyes."""
    lock_code: str = ""
    """The code that closes a locked window; "" if it is not locked."""
    every_s: float = 0.0
    """After so many seconds a locked window shows the next scene; 0: never."""
    title: str = ""
    """Of an exhibition."""
    wait_for_camera: bool = False
    """Whether the session starts without its camera, and waits for it."""


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


# what the packer has made: the light fields that replace the paths, and the pack of the first one
Packed = tuple[Sequence[str], str]


# a session that can start now, the packer while it works on the scene's disparity, and what ends
# the packer and lets `lfpipe scene clean` remove the pack
Prepared = tuple[SessionPlan, "Packing | None", contextlib.ExitStack]


def launch(arguments: UpArguments, run_policy: RunPolicy = lambda first, _: first()) -> int:
    """Runs a session; returns the exit code. run_policy: whether others follow the first. Raises
    UserError before any stage starts.
    """
    session = Session(arguments.session_name)
    if session.name in rundir.running():
        if _is_for_open_window(arguments):
            load_scene(session.name, arguments.scenes[0])
            say("shown in the open window; `--session NAME` opens another one")
            return 0
        rundir.remove(session.run_dir, rundir.acquire(session))  # raises the error with the remedy
    again = attrs.evolve(arguments, overwrite=True)  # its own files
    with contextlib.ExitStack() as splash:
        if arguments.start or arguments.lock_code:  # it takes seconds to look at cameras and scenes
            command = python(
                "lfpipe.render.display.splash",
                session.name,
                arguments.title or "lfpipe",
                arguments.display or "window",
            )
            splash.enter_context(
                subprocess.Popen(  # out of reach of the terminal: it ends with its input
                    command,
                    stdin=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,
                )
            )
        prepared = _prepared(arguments)
        return run_policy(lambda: _run(session, prepared), lambda: _run(session, _prepared(again)))


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
    from lfpipe.monitor.session_reader import snapshot

    options = snapshot(name).options
    return isinstance(options.display, Window) and not options.lock_code


def _prepared(arguments: UpArguments) -> Prepared:
    """A session that can start. Prints its settings. Raises UserError."""
    packing, packed, notes = None, None, list[str]()
    with contextlib.ExitStack() as resources:
        while True:
            message = converter().unstructure({"arguments": arguments, "packed": packed})
            # cameras, and servers of networks, have time limits of their own
            preparer = Worker(PREPARER, message, "scene and camera", float("inf"), stderr=None)
            with contextlib.closing(preparer):
                # while it works
                from lfpipe.scene.pack import PackerRequest, hold_pack, pack_until_shown

                preparer.wait(lambda: bool(preparer.last))  # noqa: B023 - not later
                answer = preparer.last or preparer.result()
                if "plan" in answer:
                    plan = converter().structure(answer["plan"], SessionPlan)
                    if plan.options.pack:
                        resources.callback(os.close, hold_pack(Path(plan.options.pack)))
                    break
            request = converter().structure(answer["to_pack"], PackerRequest)
            with progress() as bar:
                packing, summary = pack_until_shown(request, bar, answer["complete"])
            resources.callback(packing.close)
            packed = packing.scenes, summary.pack
            bad = (f"not shown: {path}: {why}" for path, why in packing.unusable.items())
            notes = [f"note\t{note}" for note in filter(None, (packing.note, *bad))]
        for line in (*plan.lines, *notes):
            head, _, text = line.partition("\t")
            say(filled(text, f"{head:<9}") if text else line)
        return plan, packing, resources.pop_all()


def _run(session: Session, prepared: Prepared) -> int:
    """Runs one session; returns the exit code.

    Raises UserError if the user can fix what ended it.
    """
    from lfpipe.supervisor.session import run_session

    plan, packing, resources = prepared
    with resources:
        outcome = run_session(session, plan.config, plan.options, say, plan.duration_s, packing)
    if outcome.final is not None and log.is_shown():
        from lfpipe.monitor.monitor import print_state

        print_state(outcome.final)
    for path in filter(exists, plan.files):
        print_result(f"{path.stat().st_size / 1e6:8.2f} MB  {path}")
    if outcome.failure is None:
        say(outcome.reason)
    return exit_code(outcome)


def exit_code(outcome: "Outcome") -> int:
    """Returns 0, or 1 after printing what failed. Raises UserError if the user can fix it."""
    if outcome.failure is None:
        return 0
    if outcome.user_error:
        raise UserError(outcome.failure, outcome.remedy)
    print_error(UserError(outcome.failure, outcome.remedy))
    return 1


EXAMPLES = """\b
Examples:
  lfpipe up --demo
  lfpipe up boxes/ flowers/ dino.h5
  lfpipe up boxes/ --display fullscreen --set screen.monitor=1
  lfpipe up --no-picture --share opentrack:127.0.0.1:4242
  lfpipe up boxes/ --camera 'file:me.mp4?loop=1' --display none --duration 20 --trace t.jsonl
"""


@click.command(epilog=EXAMPLES)
@click.argument("scenes", nargs=-1, metavar="[SCENE]...", type=PATH)
@click.option(
    "--camera",
    metavar="SRC",
    help="camera:N, camera:/dev/videoN, file:PATH[?loop=0|1&pace=recorded|max|HZ], demo or mouse.",
)
@click.option(
    "--display",
    metavar="WHERE",
    help="window, fullscreen, none, or file:OUT as .mp4, .avi or .mkv (lossless)."
    "  [default: window]",
)
@DURATION
@click.option("--trace", type=PATH, metavar="FILE", help="Write one JSON line per picture.")
@click.option(
    "--demo",
    is_flag=True,
    help="Use a built-in scene and face.",
)
@OVERWRITE
@click.option("--no-picture", is_flag=True, help="Track the eyes only, without SCENE and window.")
@SESSION
@with_settings
def up(**options: Any) -> int:
    """Show SCENE, a folder or file with a light field, from the position of the viewer's eyes.

    Several scenes, or a folder of scenes, form a playlist: switch with Tab, Page Up and Page Down.
    Press h in the window to list the keys. While a window is open, `lfpipe up SCENE` shows SCENE
    there; --session NAME opens another window.
    """
    policy = {"run_policy": options.pop("run_policy")} if "run_policy" in options else {}
    return launch(UpArguments(**options), **policy)


SAID = {
    "load": "shown: {name}",
    "share": "shared: {share}",
    "viewer": "viewer: {source}",
    "record": "record: {path}",
    "trace": "trace: {path}",
}
Send = Callable[..., None]  # of one message, and perhaps timeout_s


@click.command()
@SESSION
@click.option("--once", is_flag=True, help="Print the state once and exit.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line.")
def monitor(session_name: str, once: bool, as_json: bool) -> None:
    """Show latency, rate, drops and load of every stage of a running session.

    On a terminal, the screen updates four times a second; otherwise the state is printed once.
    If the session ends, the monitor waits for it to restart.
    Keys: q quit, p pause or resume, r reset the figures, t begin or end a trace,
    c recentre.
    """
    from lfpipe.monitor.monitor import run

    run(session_name, once, as_json)


class Leading(ExtensibleGroup):
    """A group whose own options may also follow the command: `ctl status --json`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        end = args.index("--") if "--" in args else len(args)
        front: list[str] = []
        back: list[str] = []
        words = iter(args[:end])
        for word in words:
            if word == "--session":
                front += [word, *itertools.islice(words, 1)]
            else:
                (front if word == "--json" or word.startswith("--session=") else back).append(word)
        return super().parse_args(ctx, [*front, *back, *args[end:]])


@click.group(cls=Leading)
@SESSION
@click.option("--json", "as_json", is_flag=True, help="Print answers as JSON.")
@click.pass_context
def ctl(context: click.Context, session_name: str, as_json: bool) -> None:
    """Query and control a running session. The next picture shows a change.

    For a session on another machine: ssh HOST lfpipe ctl ...
    """
    context.obj = partial(_send, session_name, as_json)


def _send(session_name: str, as_json: bool, message: Message, timeout_s: float = 3.0) -> None:
    answer = ask(session_name, message, timeout_s)
    answer.pop("v", None)
    if as_json:
        print_result(json.dumps(answer))
    elif message["cmd"] == "status":
        from lfpipe.monitor.monitor import print_state
        from lfpipe.supervisor.metrics import SessionMetrics

        print_state(converter().structure(answer, SessionMetrics), answer["paused"])
    else:
        print_result(SAID.get(message["cmd"], f"{message['cmd']}: done").format_map(answer))


def load_scene(session_name: str, scene: Path) -> None:
    """Shows another light field in a session. Raises UserError."""
    ask(session_name, {"cmd": "load", "scene": _absolute(scene)}, LOAD_TIMEOUT_S)


def _absolute(scene: Path) -> str:
    from lfpipe.scene.pack import cache_dir, named_scene  # itself slow to import

    return str(named_scene(scene, cache_dir(configuration.load().scene)).resolve())


@ctl.command("set")
@click.argument("sets", nargs=-1, required=True, metavar="KEY=VALUE...")
@click.pass_obj
def set_keys(send: Send, sets: tuple[str, ...]) -> None:
    """Change configuration keys: all of them, or none if one is refused."""
    send({"cmd": "set", "set": dict(parse_set(text) for text in sets)})


@ctl.command()
@click.argument("scene", required=False, type=PATH)
@click.option("--next", "step", flag_value=1, type=int, help="The next scene of the playlist.")
@click.option(
    "--previous", "step", flag_value=-1, type=int, help="The previous scene of the playlist."
)
@click.option("--layout", help="Layout on disk; default: detect it.")
@click.option("--grid", metavar="ROWSxCOLS", help="Grid of views; default: detect it.")
@click.pass_obj
def load(
    send: Send, scene: Path | None, step: int | None, layout: str | None, grid: str | None
) -> None:
    """Show another light field.

    If necessary, it is packed first; the current one stays visible meanwhile.
    """
    if (scene is None) == (step is None):
        raise click.UsageError("specify one of SCENE, --next and --previous")
    how = {"step": step, "scene": scene and _absolute(scene), "layout": layout, "grid": grid}
    send(
        {"cmd": "load", **{key: value for key, value in how.items() if value is not None}},
        LOAD_TIMEOUT_S,
    )


def _plain(word: str, text: str) -> None:
    @ctl.command(word, help=text)
    @click.pass_obj
    def command(send: Send) -> None:
        send({"cmd": word})


for _word, _text in {
    "status": "Print state and latency of every stage.",
    "pause": "Freeze the picture and discard frames.",
    "resume": "Continue after pause.",
    "recentre": "Make the viewer's position the centre of the grid.",
    "stop": "End the session.",
}.items():
    _plain(_word, _text)


@ctl.command()
@click.argument("source", metavar="SOURCE")
@click.pass_obj
def viewer(send: Send, source: str) -> None:
    """Choose who looks: a camera or file, as for `--camera`, `demo`, or `mouse`."""
    kind, _, path = source.partition(":")
    if kind == "file":  # the session may run in another folder
        source = f"file:{Path(path).expanduser().absolute()}"
    send({"cmd": "viewer", "source": source}, FILE_CHECK_TIMEOUT_S)


@ctl.group()
def record() -> None:
    """Record the camera of a running session."""


@record.command()
@click.argument("out", type=PATH)
@click.pass_obj
def start(send: Send, out: Path) -> None:
    """Record to the new folder OUT until `stop` or the end of the session."""
    send({"cmd": "record", "path": str(out.resolve())}, FILE_CHECK_TIMEOUT_S)


@record.command("stop")
@click.pass_obj
def stop_record(send: Send) -> None:
    """End the recording."""
    send({"cmd": "record", "path": ""})


@click.group(cls=Group)
def trace() -> None:
    """Trace a running session, one JSON line per picture, and convert traces to timelines."""


@trace.command("start")
@click.argument("out", metavar="[OUT.jsonl]", required=False, type=PATH)
@SESSION
def start_trace(out: Path | None, session_name: str) -> None:
    """Start a trace, as `lfpipe up --trace` does.

    OUT.jsonl defaults to a name with the current time, in this folder.
    """
    from lfpipe.monitor.monitor import begin_trace

    path = begin_trace(session_name, out)
    print_result(f"tracing to {path}; end it with `lfpipe trace stop`")


@trace.command("stop")
@SESSION
def stop_trace(session_name: str) -> None:
    """End the trace."""
    from lfpipe.monitor.monitor import finish_trace

    path = finish_trace(session_name)
    print_result(f"{path}: convert it to a timeline with `lfpipe trace timeline {path}`")


@trace.command("timeline")
@click.argument("source", metavar="TRACE.jsonl", type=PATH)
@click.argument("out", metavar="[OUT.json]", required=False, type=PATH)
@OVERWRITE
def write_timeline(source: Path, out: Path | None, overwrite: bool) -> None:
    """Convert a trace to Chrome trace-event JSON, which Perfetto opens.

    OUT.json defaults to the name of the trace.
    """
    from lfpipe.monitor.monitor import convert

    out = out or source.with_suffix(".json")
    convert(source, out, overwrite)
    print_result(
        f"{out}: open it at ui.perfetto.dev, which does not upload it, or in chrome://tracing"
    )
