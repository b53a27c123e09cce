"""Any damage to the files of a scene gives a message or a scene, never a traceback, a hang or high memory use."""

import random
import shutil
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.packing import pack_scene
from tests.hostile_files import PEAK_MB, ended
from tests.scene.hostile_scenes import SCENES, damage, scene_path

FUZZ = settings(max_examples=8, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
CHECKOUT = Path(__file__).parents[2]


def attempt(base: Path, name: str, seed: int) -> str:
    """Makes a scene, damages it, opens it: what lfpipe says, "" where it opened."""
    rng = random.Random(seed)
    folder = base / "scene"
    folder.mkdir(parents=True)
    SCENES[name](folder)
    for _ in range(rng.choice((1, 1, 2))):
        damage(rng, folder)
    layout = "auto" if rng.random() < 0.8 else rng.choice(sorted(layouts.layouts()))
    grid = rng.choice(("",) * 12 + ("3x3", "1x1", "9999x9999", "100x200"))
    try:
        field = pack_scene(scene_path(folder), config.Scene(cache_dir=str(base / "cache"), layout=layout, grid=grid))
    except UserError as error:
        assert error.message and error.remedy
        return str(error)
    finally:
        shutil.rmtree(folder)
    assert field.views.sum() >= 0 and max(abs(field.disparity_min_px), abs(field.disparity_max_px)) < 2 * field.width_px
    shutil.rmtree(base / "cache")
    return ""


@pytest.mark.parametrize("name", SCENES)
@FUZZ
@given(seed=st.integers(0, 1 << 32))
def test_a_damaged_scene_is_refused_or_shown(tmp_path_factory: pytest.TempPathFactory, name: str, seed: int) -> None:
    base = tmp_path_factory.mktemp("fuzz")
    attempt(base, name, seed)
    shutil.rmtree(base)


@pytest.mark.parametrize("name", SCENES)
def test_refusals_take_little_memory(tmp_path: Path, name: str) -> None:
    """One process refuses or opens many damaged scenes; its peak is that of the worst."""
    code = "import sys; from tests.scene.test_hostile_scenes import attempts; attempts(sys.argv[1], sys.argv[2], 12)"
    args = [sys.executable, "-c", code, str(tmp_path), name]
    done, _, err, peak_mb = ended(args, timeout_s=110, cwd=CHECKOUT)
    assert done == 0, err[-2000:]
    assert peak_mb < PEAK_MB


def attempts(base: str, name: str, count: int) -> None:
    """For the process of the test above."""
    for seed in range(count):
        attempt(Path(base) / str(seed), name, seed)
