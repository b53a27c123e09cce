"""Opens scenes for all callers: from the cache, or by running the packer."""

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import attrs

from lfpipe import config
from lfpipe.config import SceneSummary, converter
from lfpipe.host.files import is_dir
from lfpipe.host.worker import Worker
from lfpipe.scene.lightfield import LightField, Manifest
from lfpipe.scene.pack import cache_dir, demo_scene, named_scene, open_pack, packed
from lfpipe.scene.source import Progress

SILENT_S = 300.0  # limit without a step: a large picture, beside busy programs or on a slow disk
ScenePath = str | os.PathLike[str]


def _plain(paths: Sequence[ScenePath]) -> tuple[str, ...]:
    return tuple(os.fspath(path) for path in paths)


@attrs.frozen(kw_only=True)
class PackerRequest:
    """A request for the packer."""

    do: Literal["pack", "info"] = "pack"  # or analyse it
    scenes: tuple[str, ...] = attrs.field(converter=_plain)
    settings: config.Scene
    # whether to replace folders of light fields by their content
    expand: bool = False
    # pack: whether to add the scene to the recent ones
    remember: bool = False
    # pack: "module:function" that scores the methods on a LightField, -> {method: PSNR in dB}; this
    # package must not import the rendering packages. "": the method is chosen without scores
    scorer: str = ""
    # pack: whether a session shows the views while their disparity is measured, and needs the cores
    shown: bool = True


class Packing(Worker):
    """A packer process that works on a request."""

    def __init__(self, request: PackerRequest, progress: Progress | None = None) -> None:
        self.views: SceneSummary | None = None
        """Summary of the pack as soon as it can be shown."""
        self.scenes: list[str] = []
        """The light fields that replace the paths; the first is opened."""
        self.unusable: dict[str, str] = {}
        """Those that cannot be opened, and why."""
        self.note = ""
        """What a person should know about the rest of a folder."""
        self.step = "opening"
        """The current step, for people."""
        self.share = 0.0
        """The completed share of the step, 0 to 1."""
        self.progress = progress
        super().__init__("lfpipe.scene.packer", attrs.asdict(request), request.scenes[0], SILENT_S)

    def on_step(self, step: dict[str, Any]) -> None:
        """Processes a step of the packer."""
        if "step" in step:
            self.step = "{step} {done} of {total}".format(**step)
            self.share = step["done"] / max(1, step["total"])
            if self.progress is not None:
                self.progress(step["step"], step["done"], step["total"])
        elif "summary" in step:
            self.views = SceneSummary(**step["summary"])
        elif "scenes" in step:
            self.scenes, self.note = step["scenes"], step["note"]
        elif "unusable" in step:
            self.unusable = step["unusable"]

    def summary(self) -> SceneSummary:
        """The summary of the complete pack, once the packer is done. Raises UserError."""
        return SceneSummary(**self.result())


@attrs.frozen
class Opened:
    """An opened scene."""

    scenes: list[Path]
    """The light fields that replace the paths."""
    field: LightField
    """The first of them."""


def find_packed(
    paths: Sequence[Path], settings: config.Scene, *, scorer: str = "", expand: bool = True
) -> Opened | PackerRequest:
    """The light fields at paths, the first of them opened; a request to the packer if that one is
    not in the cache, or a folder must be searched.

    An empty sequence means the demo. scorer: as in `PackerRequest`. expand: replace a folder of
    light fields by its content. Raises UserError.
    """
    paths = [named_scene(path, cache_dir(settings)) for path in paths] or [
        demo_scene(cache_dir(settings))
    ]
    known = packed(paths[0], settings, complete=True)
    expand = expand and any(is_dir(path) and packed(path, settings) is None for path in paths)
    if known is not None and not expand:
        return Opened(paths, known)
    return PackerRequest(scenes=paths, settings=settings, expand=expand, scorer=scorer)


def pack_until_shown(
    request: PackerRequest, progress: Progress | None, complete: bool
) -> tuple[Packing, SceneSummary]:
    """The packer, and the pack as soon as it can be shown.

    progress: called from this thread. complete: wait for the disparity, for pictures that are
    saved. Raises UserError.
    """
    packing = Packing(attrs.evolve(request, shown=not complete), progress)
    try:
        packing.wait(lambda: packing.views is not None and not complete)
        summary = (
            packing.views if not packing.done and packing.views is not None else packing.summary()
        )
    except BaseException:
        packing.close()
        raise
    packing.progress = None
    return packing, summary


def open_scene(
    path: ScenePath | None,
    settings: config.Scene,
    progress: Progress | None = None,
    *,
    scorer: str = "",
) -> LightField:
    """The complete light field at path, or the demo; a child process packs it unless it is cached.

    progress: called from this thread. scorer: as in `PackerRequest`. Raises UserError.
    """
    paths = [] if path is None else [Path(path)]
    found = find_packed(paths, settings, scorer=scorer, expand=False)
    if isinstance(found, Opened):
        return found.field
    _, summary = pack_until_shown(found, progress, complete=True)
    return open_pack(Path(summary.pack), settings.invert_depth)


def absolute_path(path: Path, settings: config.Scene) -> Path:
    """A scene's path for another process; for demo:NAME, its folder. Raises UserError."""
    return named_scene(path, cache_dir(settings)).resolve()


def ask_manifest(path: Path, settings: config.Scene, progress: Progress | None = None) -> Manifest:
    """The manifest of the scene at path. The packer analyses the scene but does not pack it.

    Raises UserError.
    """
    scenes = [named_scene(path, cache_dir(settings))]
    request = PackerRequest(do="info", scenes=scenes, settings=settings, expand=True)
    with contextlib.closing(Packing(request, progress)) as packing:
        packing.wait()
        return converter().structure(packing.result(), Manifest)
