"""What stands in the cache is no file that lfpipe wrote."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from lfpipe import config
from lfpipe.scene.cache import packs, sweep
from lfpipe.scene.packing import pack_scene
from tests.scene import made


def sparse(path: Path) -> None:
    path.touch()
    os.truncate(path, 1 << 40)


@pytest.mark.parametrize("put", [os.mkfifo, Path.mkdir, sparse, lambda path: path.symlink_to("/dev/zero")])
def test_an_entry_of_the_index_that_is_no_small_file_is_passed_over(tmp_path: Path, put: Callable[[Path], None]) -> None:
    scene = config.Scene(cache_dir=str(tmp_path / "cache"))
    folder = made.write_grid(tmp_path / "scene", made.views(2, 2, 24, 32))
    first = pack_scene(folder, scene)
    entry = next((tmp_path / "cache" / "index").iterdir())
    entry.unlink()
    put(entry)
    sweep(scene)
    if not entry.is_dir():
        assert pack_scene(folder, scene).manifest["key"] == first.manifest["key"]


def test_a_link_in_one_pack_hides_no_other(tmp_path: Path) -> None:
    scene = config.Scene(cache_dir=str(tmp_path / "cache"))
    for name in ("a", "b"):
        pack_scene(made.write_grid(tmp_path / name, made.views(2, 2, 24, 32 + 8 * (name == "b"))), scene)
    for pack in (tmp_path / "cache" / "scenes").iterdir():
        (pack / "loop").symlink_to("loop")
    assert len(packs(scene)) == 2
