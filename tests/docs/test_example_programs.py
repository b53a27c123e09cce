"""The package as an installer gets it; in an environment made without uv, the programs of examples/
and docs/python.md run.
"""

import os
from pathlib import Path

import pytest

from tests.docs.conftest import ROOT, blocks
from tests.support.processes import printed
from tests.support.world import World

EXAMPLES = ROOT / "examples"
PROGRAMS = [block for block in blocks("docs/python.md") if block.count("\n") > 2]

pytestmark = pytest.mark.nightly


def run(world: World, python: Path, *words: str | Path) -> str:
    """What a program prints.

    The package comes from the environment of python, not from the checkout.
    """
    env = {key: value for key, value in world.env.items() if key != "PYTHONPATH"} | {
        "MPLBACKEND": "agg"
    }
    env["PATH"] = f"{python.parent}{os.pathsep}{os.environ['PATH']}"
    return printed(*words, cwd=world.root, env=env)


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        ("view.py SCENE view.png", "3x3 views"),
        ("from_array.py views.npy", "(96, 128, 3)"),
        ("eyes.py VIDEO", " mm"),
        ("session.py SCENE demo", "p50"),
        ("window_projection.py 80 40 600", "-600."),
        ("compare_filters.py SEQ SCENE", "mean 60 faces"),
        ("record_and_replay.sh SCENE demo", "matches reference"),
    ],
)
def test_example_program_runs(
    world: World, fresh: Path, scene: Path, clip: Path, words: str, printed: str
) -> None:
    places = {"SCENE": scene, "VIDEO": clip, "SEQ": world.root / "walk"}
    if "SEQ" in words:
        world.done("sequence", "import", clip, world.root / "walk")
    program, *arguments = words.split()
    start = [fresh] if program.endswith(".py") else []
    assert printed in run(
        world, fresh, *start, EXAMPLES / program, *(places.get(word, word) for word in arguments)
    )


@pytest.mark.parametrize("number", range(len(PROGRAMS)))
def test_examples_of_python_md_run(
    number: int, world: World, fresh: Path, scene: Path, clip: Path, request: pytest.FixtureRequest
) -> None:
    """With a small scene in place of the demo's, which takes long to pack."""
    example = (
        PROGRAMS[number]
        .replace("open_scene()", "open_scene('boxes')")
        .replace('"walk",', '"walk", "boxes",')
    )
    example = example.replace("Session(camera", "Session('boxes', camera")
    (world.root / "boxes").symlink_to(scene)
    (world.root / "face.avi").symlink_to(clip)
    if "replay(" in example:
        world.done("sequence", "import", clip, world.root / "walk")
    if "attach(" in example:
        live: World = request.getfixturevalue("live")
        world.env = live.env
        example = example.replace('"default"', f'"{live.name}"')
    where = "import lfpipe; assert 'env' in lfpipe.__file__.split('/'), lfpipe.__file__\n"
    assert run(world, fresh, fresh, "-c", where + example)
