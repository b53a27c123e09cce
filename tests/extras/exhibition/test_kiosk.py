"""An exhibition: only the code has an effect, and the desktop starts it."""

import importlib
import shutil
import subprocess
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from lfpipe.errors import UserError
from tests.support.films import write_film
from tests.support.world import World
from tests.support.xvfb_screen import Screen, needs_xdotool

exhibition = importlib.import_module(
    "lfpipe.extras.exhibition.kiosk"
)  # lfpipe.extras.exhibition.kiosk is the command


def test_kiosk_starts_again_until_it_ends_well(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(exhibition, "AGAIN_S", 0.0)
    again = Mock(side_effect=[UserError("no camera found", "plug one in"), 1, 0])
    assert exhibition.until_it_ends(lambda: 1, again) == 0
    assert capsys.readouterr().err.count("restarts") == 3


@needs_xdotool
def test_kiosk_moves_with_nobody_there_and_obeys_the_code_alone(
    world: World, scene: Path, screen: Screen
) -> None:
    world.env |= {"DISPLAY": screen.name, "LFPIPE_KIOSK_CODE": "bye42"}
    write_film(world.root / "empty.avi", [np.full((480, 640, 3), 90, np.uint8)] * 10)
    process = world.up(
        scene, "--kiosk", camera=f"file:{world.root}/empty.avi", display="fullscreen"
    )
    world.wait_for(lambda: screen.picture()[0, 0].tolist() == [26, 21, 18], "title, in full screen")
    world.wait_for(
        lambda: len({line["view"]["left"][1] for line in world.lines()}) > 20, "views in motion"
    )
    world.xdotool("key", "q", "Escape", "m", "p", "F11", "plus")
    world.more_pictures(10)
    assert process.poll() is None and world.monitor()["config"]["render"]["anaglyph"] == "dubois"
    world.xdotool("type", "--delay", 30, "bye42")
    world.ended(process)


@pytest.mark.nightly
def test_kiosk_install_writes_a_unit_of_systemd(world: World, scene: Path) -> None:
    odd = world.root / 'a "100 %" $HOME'
    scene_there = shutil.copytree(scene, odd)
    code = world.root / "code"
    code.write_text("bye42\n")
    done = world.done("kiosk", "install", "--code-file", code, scene_there, "demo:marbles")
    unit = Path(done.stdout.strip())
    text = unit.read_text()
    assert (
        unit == world.root / "settings" / "systemd" / "user" / "lfpipe-kiosk.service"
        and "bye42" not in text
    )
    assert (
        "Restart=always" in text
        and "RestartPreventExitStatus=0" in text
        and '"--kiosk" "--code-file"' in text
    )
    assert (
        'a \\"100 %%\\" $$HOME"' in text
        and '/marbles"' in text
        and "systemctl --user enable --now lfpipe-kiosk" in done.stderr
    )
    if shutil.which("systemd-analyze"):
        checked = subprocess.run(
            ["systemd-analyze", "--user", "verify", str(unit)], capture_output=True, text=True
        )
        assert "lfpipe-kiosk" not in checked.stderr, checked.stderr
    kept = world.root / "settings" / "lfpipe" / "kiosk-code"
    assert kept.read_text() == "bye42" and kept.stat().st_mode & 0o077 == 0
    for words in ((scene_there,), ("--code-file", code, "nowhere")):
        world.refused("kiosk", "install", *words)
    world.refused("up", scene, "--kiosk", "--code-file", code, "--display", "none")


@pytest.mark.nightly
@pytest.mark.parametrize("odd", ["a\nExecStart=/bin/true", "b\r", "c\x1b[2J", "d\u2028"])
def test_kiosk_install_refuses_names_that_would_add_lines_to_the_unit(
    world: World, scene: Path, odd: str
) -> None:
    named = shutil.copytree(scene, world.root / odd)
    code = world.root / "code"
    code.write_text("leave2026")
    told = world.refused("kiosk", "install", "--code-file", code, named)
    assert "contains" in told and "rename" in told
    assert not list((world.root / "settings").rglob("*.service"))
