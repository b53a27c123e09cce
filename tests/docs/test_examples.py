"""Every example of README and docs/ works: code runs, commands parse, files are accepted."""

import importlib
import json
import os
import re
import runpy
import shlex
import textwrap
import time
import tomllib
from pathlib import Path

import click
import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.cli import cli
from lfpipe.scene import layouts
from tests.docs.conftest import ROOT, blocks
from tests.world import World

PAGES = ["README.md", *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md")))]


def commands() -> list[tuple[str, str]]:
    """(page, command line) of everything in a shell block, and of every `lfpipe ...` in the text."""
    found = []
    for page in PAGES:
        lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
        lines += re.findall(r"`((?:uv run )?lfpipe [^`]+)`", (ROOT / page).read_text())
        for line in lines:
            for part in re.split(r"&&|\|\|", line.split(" #")[0]):
                words = part.strip().removeprefix("uv run ").removeprefix("ssh HOST ")
                if words.startswith("lfpipe "):
                    found.append((page, words))
    return sorted(set(found))


def test_commands_exist_with_their_options() -> None:
    context, keys = click.Context(cli), config.options()
    for page, line in commands():
        words = [word for word in shlex.split(line)[1:] if word not in ("...", "…")]
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


def test_blocks_of_data_are_well_formed() -> None:
    for page in PAGES:
        for block in blocks(page, "toml"):
            tomllib.loads(block)
        for block in blocks(page, "json"):
            json.loads(block)


def test_the_ring_example_reads_a_frame(live: World, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    example = next(block for block in blocks("docs/contracts.md") if "Reader" in block)
    path = live.root / "ring_example.py"
    path.write_text(example.replace('Session("default")', f'Session("{live.name}")'))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(live.run_dir))
    runpy.run_path(str(path))
    seq, t_sensor_ns, _skipped, mean = capsys.readouterr().out.split()
    assert int(seq) > 0 and time.monotonic_ns() - int(t_sensor_ns) < 10_000_000_000 and 0 < float(mean) < 255


def test_the_layout_example_opens_its_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    (tmp_path / "runner.py").write_text(textwrap.dedent(RUNNER).format(row=row[1].replace("lfpipe.track.away", "away")))
    world.module, world.env["PYTHONPATH"] = "runner", os.pathsep.join([str(tmp_path), str(ROOT)])
    process = world.up(scene)
    world.pictures(1)
    world.wait_for(lambda: world.monitor()["stages"]["away"]["count"] > 5, "outputs of the stage")
    process.terminate()
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0 and "failed" not in err, err
