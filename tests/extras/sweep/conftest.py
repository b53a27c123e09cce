"""A small corpus: walls as scenes, a recording with truth, one cut short."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.replay.conftest import make_sequence
from tests.scene import made

SCENES = 4


def write_wall(folder: Path, shift: int) -> Path:
    return made.write_grid(folder, np.roll(made.wall(3, 3, 64, 64), shift, axis=2))


@pytest.fixture(scope="session")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """scenes/s0 ... s3, recordings/walk, broken/cut."""
    root = tmp_path_factory.mktemp("corpus")
    for k in range(SCENES):
        write_wall(root / "scenes" / f"s{k}", 3 * k)
    make_sequence(root / "recordings" / "walk", 20)
    shutil.copytree(root / "recordings" / "walk", root / "broken" / "cut")
    frames = root / "broken" / "cut" / "frames.bin"
    frames.write_bytes(frames.read_bytes()[:5000])
    return root


def write_plan(folder: Path, corpus: Path, text: str) -> Path:
    """A plan in folder; CORPUS in its text is the corpus."""
    path = folder / "plan.toml"
    path.write_text(text.replace("CORPUS", str(corpus)))
    return path
