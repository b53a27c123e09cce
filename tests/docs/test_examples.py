"""Every example of README and docs/ works: code runs, commands parse, files are accepted; recipes
run on a session's data.
"""

import ast
import asyncio
import importlib
import json
import os
import re
import runpy
import shlex
import shutil
import socket
import subprocess
import sys
import textwrap
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.cli import cli
from lfpipe.scene import layouts
from lfpipe.share.output import LslOutput, Sample, osc_datagram
from lfpipe.share.target import Target
from lfpipe.transport.clock import now_ns
from tests.docs.conftest import ROOT, blocks
from tests.share.receivers import free_port, lsl_environment
from tests.share.test_outputs import HEAD
from tests.support.world import World

PAGES = ["README.md", *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md")))]


def texts() -> Iterator[tuple[str, list[str], bool]]:
    """(page or module, command lines of one shell block or one text, whether it is a block)."""
    for page in PAGES:
        for block in (*blocks(page, "sh"), *blocks(page, "")):
            yield page, block.splitlines(), True
        text = re.sub("^#.*$", "", (ROOT / page).read_text(), flags=re.M)  # usage of commands
        yield page, re.findall(r"`((?:uv run )?(?:lfpipe|python -m) [^`]+)`", text), False
    for path in sorted((ROOT / "lfpipe").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr | ast.Constant):
                # what a message fills in: an option after a word, else an argument
                text = re.sub(r"(?<=\w)\{[^}]*\}", "", ast.unparse(node)).replace("\\n", " ")
                text = re.sub(r"\{[^}]*\}", "NAME", text)
                named = re.findall(r"`(lfpipe (?![A-Z])[^`]+)`", text)
                yield str(path.relative_to(ROOT)), [" ".join(line.split()) for line in named], False


def commands() -> dict[str, tuple[str, bool]]:
    """Command lines of pages and messages in their order, each with the first place that prints it
    and whether it stands in a block there: elsewhere it may only name a command.
    """
    found: dict[str, tuple[str, bool]] = {}
    for place, lines, block in texts():
        for line in lines:
            for part in re.split(r"&&|\|\||;| \| ", line.split(" #")[0]):
                words = part.strip().removeprefix("uv run ").removeprefix("ssh HOST ")
                if words.startswith(("lfpipe ", "python -m ")):
                    found.setdefault(words, (place, block))
    return found


def test_commands_exist_with_their_options() -> None:
    context = click.Context(cli)
    keys = config.options()
    for line, (page, _) in commands().items():
        if line.startswith("python"):
            continue
        words = [word for word in shlex.split(line)[1:] if word not in ("...", "…", "-v")]
        command: click.Command | None = cli
        while isinstance(command, click.Group) and words and not words[0].startswith("-"):
            command = command.get_command(context, words.pop(0))
            assert command is not None, f"{page}: {line}: there is no such command"
        assert command is not None
        options = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        for name in (word.split("=")[0] for word in words if word.startswith("--")):
            assert name in options or isinstance(command, click.Group), f"{page}: {line}: no {name}"
        for key in re.findall(r"(?:--set |ctl set |^)([a-z]+\.[a-z_]+)=", line):
            assert key in keys, f"{page}: {line}: no key {key}"


# Names on the pages for which the small scene stands
SCENES = "SCENE PATH views boxes antinous rectified Bikes buddha raster pair mosaics slide-views"
SCENES += " photo.jpg photo.mpo photo_rgbd.png flower_eslf.png name_qs8x6a0.75.png atlas.png"
SCENES += " scene.mat"
ELSEWHERE = {  # commands that are not run here, and why
    r"--(web|kiosk|on|latency)\b|calibrate|kiosk": "runs until somebody ends it",
    r"cameras|record$": "needs a camera",
    r"models get|10\.0\.0\.7": "needs a network",
    r"scenes/|lf\.h5|clip\.mp4|slide\.mp4|up wiggle": "needs more than a small scene",
    r"bench table|scene make": "needs more than a small scene",
    r"lsl|share stop": "needs a library, or a target: tests/share",
    r"\b(WORD|KEY|NAME|OUT|REF|FILE|TARGET|HOST|SRC|V\?pace)\b|\[|\.\.\.": "needs an argument",
    r"--(session|set|out|trace)$": "names an option",
    r"\bctl stop": "others need the session",
    r"desktop": "writes to the home folder",
    r"bench (?!pipeline|viewer)": "takes minutes",
}


def ending(line: str) -> list[str]:
    """The arguments of Python that run a command so that it ends without a camera or a screen."""
    words = [word.replace("path/to/views", "views") for word in shlex.split(line)[1:]]
    words = [word.rstrip("/") for word in words]
    if words[:2] == ["sequence", "cut"] and "--from" in words:
        words[-3::2] = ["0.2", "0.5"]  # of a short one
    if line.startswith("python"):
        return [*words[:2], "--help"]  # its modules load; the rest takes minutes
    if "up" in words[:2]:
        words += ["--duration", "0.5", "--session", "other"]
        words += [] if "--no-picture" in words else ["--display", "none"]
    if "up" in words[:2] or words[0] == "record":
        words += [] if "--camera" in words else ["--camera", "demo"]
    if words[0] == "record":
        words += ["--duration", "0.5"]
    if words[0] == "monitor":
        words += ["--once"]
    if words[0] == "bench":
        words += ["--quick"]
    return ["-m", "lfpipe", *words]


@pytest.mark.parametrize("page", [*PAGES, "lfpipe/"])
def test_commands_run_as_printed(world: World, scene: Path, clip: Path, page: str) -> None:
    """Each that ends by itself, in the order of the page, while a session runs."""
    lines = {
        line: block
        for line, (place, block) in commands().items()
        if place.startswith(page)
        and (line.startswith("python") or not any(re.search(why, line) for why in ELSEWHERE))
    }
    if not lines:
        pytest.skip("no command on this page ends by itself")
    (world.root / "tests").mkdir()
    for name in (*SCENES.split(), "tests/views"):
        (world.root / name).symlink_to(scene)
    for name in ("me.avi", "VIDEO"):
        (world.root / name).symlink_to(clip)
    np.save(world.root / "views.npy", np.zeros((3, 3, 48, 64, 3), np.uint8))
    plan = 'sequences = ["walk"]\nscenes = ["SCENE"]\nsubjects = ["replay"]\n'
    (world.root / "plan.toml").write_text(plan)
    for name in ("walk", "talk", "tests/walk"):
        world.done("sequence", "import", clip, name)
    world.up(scene, scene)  # a playlist
    world.pictures(1)
    env = world.env | {"LFPIPE_SESSION": world.name}
    wrong = []
    for line, block in lines.items():
        if re.search(r"record (start )?[\w/]*walk|import", line):
            shutil.rmtree(world.root / ("tests/walk" if "tests/walk" in line else "walk"))
        done = subprocess.run(
            [sys.executable, *ending(line)],
            cwd=ROOT if line.startswith("python") else world.root,
            env=env,
            capture_output=True,
            text=True,
            timeout=300,
        )
        answer = done.stdout + done.stderr
        if not block and done.returncode == 2 and re.search("Usage:|no SCENE", answer):
            continue  # the text only names the command
        if done.returncode and not (line == "lfpipe doctor" and done.returncode == 1):
            wrong.append(f"{line}: {done.returncode}\n{answer[-600:]}")
    assert not wrong, "\n".join(wrong)


def test_blocks_of_data_are_well_formed() -> None:
    for page in PAGES:
        for block in blocks(page, "toml"):
            tomllib.loads(block)
        for block in blocks(page, "json"):
            json.loads(block)


def test_the_ring_example_reads_a_frame(
    live: World, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    example = next(block for block in blocks("docs/contracts.md") if "Reader" in block)
    path = live.root / "ring_example.py"
    path.write_text(example.replace('Session("default")', f'Session("{live.name}")'))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(live.run_dir))
    runpy.run_path(str(path))
    seq, t_sensor_ns, _skipped, mean = capsys.readouterr().out.split()
    assert (
        int(seq) > 0
        and time.monotonic_ns() - int(t_sensor_ns) < 10_000_000_000
        and 0 < float(mean) < 255
    )


def test_the_layout_example_opens_its_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    example = next(block for block in blocks("docs/extending.md") if "def detect" in block)
    (tmp_path / "trio.py").write_text(example)
    monkeypatch.setattr(layouts, "__path__", [*layouts.__path__, str(tmp_path)])
    importlib.invalidate_caches()
    scene = tmp_path / "scene"
    scene.mkdir()
    for value, name in enumerate(("left", "middle", "right")):
        cv2.imwrite(str(scene / f"{name}.png"), np.full((8, 8, 3), 10 * value, np.uint8))
    found = layouts.describe(scene, config.Scene())
    assert (found.layout, found.rows, found.cols) == ("trio", 1, 3)


RUNNER = """
    from lfpipe.supervisor import process_table
    from lfpipe.supervisor.process_table import Stage

    if __name__ == "__main__":
        process_table.STAGES = (*process_table.STAGES, {row})
        process_table.NAMES = tuple(stage.name for stage in process_table.STAGES)
        from lfpipe.cli import run

        run()
"""


def test_the_stage_example_runs_in_a_session(world: World, scene: Path, tmp_path: Path) -> None:
    page = (ROOT / "docs" / "extending.md").read_text()
    row = re.search(r"`(Stage\(.*?\))`\.", page, re.S)
    assert row is not None
    example = next(block for block in blocks("docs/extending.md") if "def main" in block)
    (tmp_path / "away.py").write_text(example)
    (tmp_path / "runner.py").write_text(
        textwrap.dedent(RUNNER).format(row=row[1].replace("lfpipe.track.away", "away"))
    )
    world.module = "runner"
    world.env["PYTHONPATH"] = os.pathsep.join([str(tmp_path), str(ROOT)])
    process = world.up(scene)
    world.pictures(1)
    world.wait_for(lambda: world.monitor()["stages"]["away"]["count"] > 5, "outputs of the stage")
    process.terminate()
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0 and "failed" not in err, err


def program(word: str) -> str:
    """The block of Python that holds word."""
    return next(block for block in blocks("docs/recipes.md") if word in block)


def test_the_window_keeps_the_screen_where_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    exec(program("window_projection"), names)
    assert capsys.readouterr().out.strip() == "[1. 1.]"
    made = names["window_projection"]
    for eye in ((0, 0, 600), (120, -80, 450), (-200, 60, 900)):
        projection, view = made(eye, (530, 300))  # type: ignore[operator]
        for corner in ((-265, -150), (265, -150), (-265, 150)):
            seen = projection @ view @ (*corner, 0, 1)
            np.testing.assert_allclose(seen[:2] / seen[3], np.sign(corner), atol=1e-9)
        behind = projection @ view @ (*eye[:2], -300, 1)  # straight ahead of the eye
        at_screen = projection @ view @ (*eye[:2], 0, 1)
        np.testing.assert_allclose(behind[:2] / behind[3], at_screen[:2] / at_screen[3], atol=1e-9)


def test_the_bridge_passes_eyes_on_to_a_page(tmp_path: Path) -> None:
    from tornado.websocket import websocket_connect

    osc_port, web_port = free_port(), free_port()
    words = [sys.executable, "-c", program("WebSocketHandler"), str(osc_port), str(web_port)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and process.stdout.readline().strip() == "passing on"

            async def heard() -> dict[str, list[float]]:
                connection = await websocket_connect(f"ws://127.0.0.1:{web_port}/eyes")
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                    sender.sendto(osc_datagram(Sample(1, 2, 3, HEAD)), ("127.0.0.1", osc_port))
                message = await asyncio.wait_for(connection.read_message(), 60)
                connection.close()
                return dict(json.loads(message or ""))

            message = asyncio.run(heard())
        finally:
            process.kill()
    assert message["left"] == pytest.approx(HEAD.left_mm) and message["right"] == pytest.approx(
        HEAD.right_mm
    )


def test_the_experiment_reads_eyes_on_its_own_clock(tmp_path: Path) -> None:
    pytest.importorskip("pylsl")
    os.environ |= lsl_environment(tmp_path)
    name = f"lab{os.getpid()}"
    output = LslOutput(Target(kind="lsl", name=name), "recipe", 30.0, True)
    example = program("lab-eyes")
    command = [sys.executable, "-c", example.replace("lab-eyes", f"{name}-eyes")]
    try:
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            for seq in range(3000):
                output.send(Sample(seq, now_ns(), now_ns(), HEAD))
                time.sleep(0.02)
                if process.poll() is not None:
                    break
            process.kill()
            out, err = process.communicate()
    finally:
        output.close()
    lines = out.splitlines()
    assert len(lines) == 10 and all(
        line.split()[:3] == ["-40.0", "5.0", "600.0"] for line in lines
    ), err
