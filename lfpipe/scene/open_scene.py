"""One way to open a scene: its pack from the cache, or the packer's work, whoever asks."""

import contextlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import attrs

from lfpipe import config
from lfpipe.config import SceneSummary
from lfpipe.errors import UserError
from lfpipe.host.files import is_dir
from lfpipe.host.worker import Worker
from lfpipe.scene.cache import cache_dir, find_pack
from lfpipe.scene.demo import demo_scene
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import DamagedPackError, open_pack

SILENT_S = 60.0  # without a step: a large picture on a slow disk
Progress = Callable[[str, int, int], None]  # (task, steps done, steps in total)


def silent(_task: str, _done: int, _total: int) -> None:
    """Ignores progress."""


class Packing(Worker):
    """The packer at work on the first of some scenes.

    views: the summary of the pack as soon as it can be shown. scenes: with expand, the light fields that the paths stand for.
    step, share: what it is doing, for people, and the share of that which is done; "" before the first.
    """

    def __init__(
        self,
        scenes: Sequence[str | os.PathLike[str]],
        settings: config.Scene,
        do: str = "pack",
        expand: bool = False,
        remember: bool = False,
        out: Path | None = None,
    ) -> None:
        paths = [os.fspath(path) for path in scenes]
        self.views: SceneSummary | None = None
        self.scenes: list[Path] = []
        self.step, self.share = "", 0.0
        self.progress: Progress = silent
        request = {
            "do": do,
            "scenes": paths,
            "expand": expand,
            "remember": remember,
            "out": os.fspath(out or ""),
            "config": attrs.asdict(settings),
        }
        super().__init__("lfpipe.scene.packer", request, paths[0], SILENT_S)

    def heard(self, step: dict[str, Any]) -> None:
        """Notes a step of the packer."""
        if "step" in step:
            self.step = "{step} {done} of {total}".format(**step)
            self.share = step["done"] / max(1, step["total"])
            self.progress(step["step"], step["done"], step["total"])
        elif "summary" in step:
            self.views = SceneSummary(**step["summary"])
        elif "scenes" in step:
            self.scenes = [Path(text) for text in step["scenes"]]

    def summary(self) -> SceneSummary:
        """The summary of the complete pack, once the packer is done. Raises UserError."""
        return SceneSummary(**self.result()["summary"])


@attrs.frozen
class Opened:
    """scenes: the light fields that paths stand for. field: the first. packing: the packer while it works on its disparity."""

    scenes: list[Path]
    field: LightField
    packing: Packing | None = None


def open_scenes(paths: Sequence[Path], settings: config.Scene, progress: Progress = silent, *, complete: bool = False) -> Opened:
    """Opens the first of the light fields at paths as soon as it can be shown; a folder of light fields stands for those in it.

    An empty sequence stands for the demo. progress: called from this thread. complete: with its disparity, for pictures that are
    kept. Raises UserError.
    """
    paths = list(paths) or [demo_scene(cache_dir(settings))]
    known = packed(paths[0], settings)
    unclear = [path for path in paths if find_pack(path, settings) is None and is_dir(path)]
    if known is not None and known.complete and not unclear:
        return Opened(paths, known)
    packing = Packing(paths, settings, expand=bool(unclear))
    try:
        packing.progress = progress
        packing.wait(lambda: packing.views is not None and not complete)
        summary = packing.views if not packing.done and packing.views is not None else packing.summary()
        packing.progress = silent
        field = open_pack(Path(summary.pack), settings.half_turn)
        return Opened(packing.scenes or paths, field, None if packing.done else packing)
    except BaseException:
        packing.close()
        raise


def open_scene(path: str | os.PathLike[str] | None, settings: config.Scene, progress: Progress = silent) -> LightField:
    """The light field at path, or the demo's, complete: packed now by a child process unless it has been before.

    progress: called from this thread. Raises UserError.
    """
    if path is None:
        path = demo_scene(cache_dir(settings))
    if (field := packed(path, settings)) is not None and field.complete:
        return field
    with contextlib.closing(Packing([path], settings)) as packing:
        packing.progress = progress
        packing.wait()
        return open_pack(Path(packing.summary().pack), settings.half_turn)


def packed(path: str | os.PathLike[str], settings: config.Scene) -> LightField | None:
    """The pack of an unchanged scene, perhaps without disparity yet; None without one. Reads no picture."""
    with contextlib.suppress(DamagedPackError):
        pack = find_pack(path, settings)
        return None if pack is None else open_pack(pack, settings.half_turn)
    return None


def scene_facts(path: str | os.PathLike[str], settings: config.Scene) -> dict[str, Any]:
    """The facts of an unpacked scene, as `info.describe_examined`, without packing it. Raises UserError."""
    with contextlib.closing(Packing([path], settings, do="info")) as packing:
        packing.wait()
        info = packing.result().get("info")
    if not isinstance(info, dict):
        raise UserError(f"{path}: no answer from the packer", "try again")
    return info


def make_from_video(path: Path, out: Path, settings: config.Scene, progress: Progress = silent) -> dict[str, Any]:
    """Makes a light field of one row from a video or a folder of pictures, as `slide.make_slide`; returns the facts of its Slide.

    Raises UserError.
    """
    with contextlib.closing(Packing([path], settings, do="make", out=out)) as packing:
        packing.progress = progress
        packing.wait()
        return dict(packing.result()["slide"])
