"""`lfpipe` without arguments: on a desktop a choice of the demo and recent scenes, elsewhere the help."""

import json

import numpy as np

from lfpipe.scene.demo import NAME
from tests.world import World, write_scene
from tests.xvfb_screen import Screen, needs_xdotool, outline


def test_without_a_screen_it_is_the_help(world: World) -> None:
    done = world.run()
    assert done.returncode == 2 and "Usage: lfpipe" in done.stderr


@needs_xdotool
def test_scenes_shown_before_are_there_to_choose_from(world: World, screen: Screen) -> None:
    world.env |= {"DISPLAY": screen.name, "LFPIPE_SESSION": world.name}
    write_scene(world.root / "cache" / "lfpipe" / "demo" / NAME, 2, 2)  # the real one takes half a minute to make
    recent = [write_scene(world.root / f"shown before {k}", 1, 2 + k) for k in (1, 2)]
    kept = world.root / "state" / "lfpipe" / "recent_scenes.json"
    kept.parent.mkdir(parents=True)
    kept.write_text(json.dumps([*map(str, recent), str(world.root / "gone")]))
    settings = world.root / "settings" / "lfpipe" / "config.toml"
    process = world.start()
    world.wait_for(lambda: outline(f"lfpipe: {NAME} (h shows the keys, g tests your glasses)", screen.name), "window")
    world.xdotool("key", "Left", "Return")  # no glasses
    world.wait_for(lambda: settings.exists() and "mono" in settings.read_text(), "an answer")
    face = world.wait_for(lambda: _skin(screen), "what the camera sees")
    assert face > 200
    for colour in ([5, 13, 13], [5, 21, 21]):  # BGR of their middle views
        world.wait_for(lambda colour=colour: (screen.picture() == colour).all(axis=-1).sum() > 1000, "a scene that is not packed")
    world.xdotool("key", *["Right"] * 4, "Return")
    world.wait_for(lambda: outline("lfpipe: shown before 2", screen.name), "the scene that was chosen")
    newest_first = [str(recent[1]), str(recent[0])]
    world.wait_for(lambda: json.loads(kept.read_text())[:2] == newest_first, "the list of recent scenes")
    world.xdotool("key", "q")
    assert "no camera found" in world.ended(process)


def _skin(screen: Screen) -> int:
    """How many pixels of the screen are as red as skin: the scenes of this test are dark."""
    blue, green, red = np.moveaxis(screen.picture().astype(int), -1, 0)
    return int(((red > 150) & (red > green + 20) & (green > blue)).sum())
