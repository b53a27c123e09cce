"""The packer as a child process: results, refusals, and leftovers after a kill or full disk."""

import os
import signal
import subprocess
import sys
from contextlib import closing
from functools import partial
from pathlib import Path

import attrs
import numpy as np
import psutil
import pytest
from PIL import Image

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.pack import (
    PackerRequest,
    Packing,
    ask_manifest,
    find_packed,
    open_scene,
    pack_until_shown,
    packed,
    packs,
)
from tests.scene import made
from tests.support.world import runs, until


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made.write_grid(tmp_path / "scene", made.views(3, 3), "input_Cam{n:03d}.png")
    return tmp_path / "scene"


def test_a_scene_is_packed_by_a_child_once_and_its_facts_need_no_pack(
    folder: Path, scene_config: config.Scene
) -> None:
    manifest = ask_manifest(folder, scene_config)
    assert (manifest.rows, manifest.cols, manifest.key) == (3, 3, "") and packed(
        folder, scene_config
    ) is None
    steps: list[str] = []
    field = open_scene(folder, scene_config, lambda what, *_: steps.append(what))
    assert (field.rows, field.cols, field.complete) == (3, 3, True) and field.disparity is not None
    assert steps.index("views") < steps.index("disparity")
    steps.clear()
    assert (
        open_scene(folder, scene_config, lambda what, *_: steps.append(what)).folder == field.folder
        and not steps
    )


@pytest.mark.native("limits of processes")
def test_a_packer_may_use_a_gigabyte_of_memory(folder: Path, scene_config: config.Scene) -> None:
    """As docs/security.md promises; what the interpreter had before does not count."""
    request = PackerRequest(scenes=[folder], settings=scene_config)
    with closing(Packing(request)) as packing:
        child = psutil.Process(packing._process.pid)  # which can be asked until somebody waits
        limit = partial(child.rlimit, psutil.RLIMIT_DATA)
        until(lambda: 1 << 30 < limit()[0] < 1.5 * (1 << 30), "the limit")


def test_a_folder_of_scenes_stands_for_them(folder: Path, scene_config: config.Scene) -> None:
    made.write_grid(folder.parent / "scene2", made.views(2, 2), "input_Cam{n:03d}.png")
    (folder.parent / "notes").mkdir()
    request = find_packed([folder.parent], scene_config)
    assert isinstance(request, PackerRequest)
    packing, summary = pack_until_shown(request, None, complete=False)
    packing.close()
    assert packing.scenes == [str(folder), str(folder.parent / "scene2")] and summary.rows == 3


def test_a_scene_that_cannot_be_opened_does_not_stop_a_playlist(
    folder: Path, scene_config: config.Scene
) -> None:
    bad = folder.parent / "bad.mpo"
    bad.write_bytes(b"\xff\xd8\xff")
    request = PackerRequest(scenes=[bad, folder], settings=scene_config)
    packing, summary = pack_until_shown(request, None, complete=False)
    packing.close()
    assert summary.name == folder.name and packing.scenes == [str(folder), str(bad)]
    assert "bad.mpo" in packing.unusable[str(bad)]
    with pytest.raises(UserError, match=r"bad\.mpo"):
        pack_until_shown(attrs.evolve(request, scenes=[bad, bad]), None, complete=False)


def test_a_killed_packer_leaves_a_pack_that_the_next_completes(
    folder: Path, scene_config: config.Scene
) -> None:
    with closing(Packing(PackerRequest(scenes=[folder], settings=scene_config))) as packing:
        packing.wait(lambda: packing.views is not None)
        assert packing.views is not None and not packing.views.complete
        os.kill(packing._process.pid, signal.SIGKILL)
        packing.wait()
        with pytest.raises(UserError, match="signal 9"):
            packing.result()
    unfinished = packed(folder, scene_config)
    assert unfinished is not None and not unfinished.complete
    found = unfinished.folder
    del unfinished
    for name in ("disparity.npy", "interim.npy"):
        Path(found, name).write_bytes(b"half a file")
    field = open_scene(folder, scene_config)
    assert field.complete and field.folder == found and field.disparity is not None
    assert np.array_equal(field.views[0].transpose(0, 1, 3, 4, 2), made.views(3, 3))


FULL = """
import resource, signal, sys
from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.packing import pack_scene
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

def full(*_):
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))

try:
    if sys.argv[4] == "views":
        full()
    pack_scene(sys.argv[1], config.Scene(cache_dir=sys.argv[2]), views_ready=full)
except UserError as error:
    sys.exit(f"refused: {error}")
"""


@pytest.mark.parametrize(("during", "count"), [("views", 0), ("disparity", 1)])
def test_a_full_disk_is_a_refusal_and_never_a_whole_pack(
    folder: Path, scene_config: config.Scene, during: str, count: int
) -> None:
    command = [sys.executable, "-c", FULL, str(folder), scene_config.cache_dir, "5000", during]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.stderr.startswith("refused:") and "scene.cache_dir" in run.stderr, run.stderr
    assert [pack.manifest and pack.manifest.complete for pack in packs(scene_config)] == [
        False
    ] * count
    assert open_scene(folder, scene_config).complete


def test_too_much_memory_is_a_refusal(tmp_path: Path, scene_config: config.Scene) -> None:
    """A deflate bomb: 256 MB of zeros in a file of 1 MB."""
    Image.new("RGB", (9000, 9500)).save(tmp_path / "big.png", compress_level=1)
    code = (  # in a process of its own: its packer is its only child
        "import sys, resource; from lfpipe import config; from lfpipe.errors import UserError\nfrom"
        " lfpipe.scene.pack import open_scene\ntry: open_scene(sys.argv[1],"
        " config.Scene(cache_dir=sys.argv[2]))\nexcept UserError as error:"
        " print(bool(error.remedy), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    words = [sys.executable, "-c", code, str(tmp_path / "big.png"), scene_config.cache_dir]
    remedy, peak_kb = subprocess.run(
        words, capture_output=True, text=True, check=True
    ).stdout.split()
    assert remedy == "True" and int(peak_kb) < 300_000


def test_the_packer_ends_with_its_parent(folder: Path, scene_config: config.Scene) -> None:
    code = (
        "import sys, os; from lfpipe import config\n"
        "from lfpipe.scene.pack import PackerRequest, Packing\n"
        "settings = config.Scene(cache_dir=sys.argv[2])\n"
        "packing = Packing(PackerRequest(scenes=[sys.argv[1]], settings=settings))\n"
        "print(packing._process.pid, flush=True); os.kill(os.getpid(), 9)"
    )
    os.mkfifo(folder / "x")
    run = subprocess.run(
        [sys.executable, "-c", code, str(folder), scene_config.cache_dir],
        capture_output=True,
        text=True,
    )
    pid = int(run.stdout)
    until(lambda: not runs(pid), "end of the child", 20)
