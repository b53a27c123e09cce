"""A small corpus: walls as scenes, a recording with truth, one cut short."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.bench.inputs import wall
from tests.replay.conftest import make_sequence

SCENES = 4


def write_wall(folder: Path, shift: int) -> Path:
    views = np.roll(wall(3, 3, 64).views[0], shift, axis=3)
    folder.mkdir(parents=True)
    for row, col in np.ndindex(3, 3):
        cv2.imwrite(str(folder / f"view_{row}_{col}.png"), views[row, col].transpose(1, 2, 0))
    return folder


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
