"""An exhibition: no key does anything but the code, and the desktop starts it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from lfpipe.render.key_bindings import KeyBindings
from lfpipe.render.key_lock import KeyLock
from lfpipe.transport.clock import SECOND_NS
from tests.world import World
from tests.xvfb_screen import Screen


def test_the_code_opens_wherever_it_is_typed_and_nothing_else_does() -> None:
    lock = KeyLock("ab12")
    assert [lock.opens(char) for char in ["x", "a", "a", "b", "", "1", "2"]] == [False] * 6 + [True]
    assert not any(KeyLock("ab12").opens(char) for char in "ba12ab21qq")


@pytest.mark.parametrize(
    ("code", "at", "alone_s", "loads"), [("bye42", 2, 61, 1), ("bye42", 2, 59, 0), ("bye42", 0, 99, 0), ("", 2, 99, 0)]
)
def test_the_next_visitor_begins_with_the_first_scene(code: str, at: int, alone_s: int, loads: int) -> None:
    asked: list[dict[str, object]] = []
    options = SimpleNamespace(kiosk=code, playlist_at=at)
    row = {"t_face_ns": SECOND_NS}
    context = SimpleNamespace(options=options, row=row, request=lambda word, **more: asked.append({word: more}))
    keys = SimpleNamespace(_context=context, _first_due_ns=0)
    for _ in range(3):  # asked for once, however often it is looked at
        KeyBindings._return_to_first(keys, (1 + alone_s) * SECOND_NS)  # type: ignore[arg-type]
    assert asked == [{"load": {"at": 0}}] * loads


@pytest.mark.skipif(shutil.which("xdotool") is None, reason="apt-get install xdotool")
def test_keys_do_nothing_until_the_code_is_typed(world: World, scene: Path, screen: Screen) -> None:
    world.env["DISPLAY"] = screen.name
    process = world.start("up", scene, "--camera", "demo", "--trace", world.trace, "--session", world.name, "--kiosk", "bye42")
    world.pictures(3)
    subprocess.run(["xdotool", "key", "q", "Escape", "m", "p", "F11", "plus"], check=True, env=world.env)
    before = len(world.lines())
    world.pictures(before + 30)
    assert process.poll() is None and '"dubois"' in world.run("ctl", "--session", world.name, "--json", "status").stdout
    subprocess.run(["xdotool", "type", "--delay", "30", "bye42"], check=True, env=world.env)
    assert process.wait(20) == 0


def test_the_unit_starts_it_again_and_quotes_what_systemd_would_expand(world: World, scene: Path) -> None:
    odd = world.root / 'a "100 %" $HOME'
    scene_there = shutil.copytree(scene, odd)
    done = world.run("kiosk", "install", "--user", "--code", "bye42", scene_there)
    assert done.returncode == 0, done.stderr
    unit = Path(done.stdout.strip())
    text = unit.read_text()
    assert unit == world.root / "settings" / "systemd" / "user" / "lfpipe-kiosk.service" and unit.stat().st_mode & 0o077 == 0
    assert "Restart=always" in text and "RestartPreventExitStatus=0" in text and '"--kiosk" "bye42"' in text
    assert 'a \\"100 %%\\" $$HOME"' in text and "systemctl --user enable --now lfpipe-kiosk" in done.stderr
    if shutil.which("systemd-analyze"):
        checked = subprocess.run(["systemd-analyze", "--user", "verify", str(unit)], capture_output=True, text=True)
        assert "lfpipe-kiosk" not in checked.stderr, checked.stderr
    for words in (("--code", "1111", scene_there), ("--code", "bye42", "nowhere")):
        assert world.run("kiosk", "install", "--user", *words).returncode == 2
    assert world.run("up", scene, "--kiosk", "bye42", "--display", "none").returncode == 2
