"""Demo light fields: folders with one small file. The packer renders their views, with exact
disparity.
"""

import contextlib
import hashlib
import json
import os
import re
import shutil
import weakref
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import attrs
import numpy as np
import platformdirs
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.config import SceneSummary, converter
from lfpipe.errors import UserError
from lfpipe.files.safe_files import (
    TABLE_BYTES,
    check_regular,
    json_fields,
    open_regular,
    read_bytes,
    reason,
    write_file,
)
from lfpipe.host.files import exists, is_dir, lock_file, lock_open, reserve
from lfpipe.host.worker import Worker
from lfpipe.scene.lightfield import VERSION, DisparitySource, LightField, Manifest, shown_as
from lfpipe.scene.source import DEEPEST, Listing, Progress, list_scene

DEMO = "still-life"  # the default demo
DEMOS = (DEMO, "marbles", "meadow")
DEMO_VERSION = 3  # increase it when the pictures change: older packs then stay untouched
DEMO_PREFIX = "demo:"  # demo:marbles is accepted in place of a path
DEMO_MARKER = "lfpipe-demo.json"
DEMO_SIZE_PX = 512  # of a view, both sides, that the scenes are described for, and benchmarks use
SHOWN_PX = 768  # of those on a screen: drawn at full quality at 60 Hz on two cores


def demo_scene(cache_dir: Path, name: str = DEMO, size_px: int = SHOWN_PX) -> Path:
    """The folder of one of DEMOS below cache_dir.

    Raises UserError if the cache cannot be written.
    """
    folder = (
        cache_dir / f"demo-{DEMO_VERSION}" / (name if size_px == SHOWN_PX else f"{name}-{size_px}")
    )
    marker = folder / DEMO_MARKER
    with writing(cache_dir):
        if not marker.is_file():
            about = {"scene": name, "version": DEMO_VERSION, "size_px": size_px}
            write_file(marker, json.dumps(about).encode(), 0o644)
    return folder


def named_scene(path: Path, cache_dir: Path) -> Path:
    """The folder of demo:DEMO, or path itself. Raises UserError."""
    word = str(path)
    if not word.startswith(DEMO_PREFIX) or exists(path):
        return path
    if (name := word.removeprefix(DEMO_PREFIX)) not in DEMOS:
        raise UserError(
            f"{word}: no such scene", f"use {', '.join(DEMO_PREFIX + name for name in DEMOS)}"
        )
    return demo_scene(cache_dir, name=name)


VIEWS, DISPARITY, MANIFEST = "views.npy", "disparity.npy", "manifest.json"
INTERIM = "interim.npy"  # while the disparity is estimated


class DamagedPackError(UserError):
    """A folder that is not a pack of this version, or is damaged."""


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Writes the manifest atomically. Raises OSError."""
    data = json.dumps(attrs.asdict(manifest), indent=1, allow_nan=False).encode()
    write_file(folder / MANIFEST, data, 0o666)


@contextlib.contextmanager
def _reading(folder: Path) -> Iterator[None]:
    """Turns any exception of reading a pack, perhaps not lfpipe's own, into DamagedPackError."""
    try:
        yield
    except DamagedPackError:
        raise
    except (UserError, OSError, ValueError, TypeError, LookupError, OverflowError) as error:
        why = reason(error) if isinstance(error, OSError) else str(error)
        raise DamagedPackError(
            f"{folder}: not a usable pack: {why}", "make it again with `lfpipe scene pack`"
        ) from None


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a pack.

    Raises DamagedPackError if it is missing, damaged or of another version.
    """
    with _reading(folder):
        manifest = json_fields(read_bytes(folder / MANIFEST, TABLE_BYTES), MANIFEST, "").values
        if manifest.get("version") != VERSION:
            raise ValueError(f"it has another version; this lfpipe reads version {VERSION}")
        return converter().structure(manifest, Manifest)


def make_array(
    path: Path, shape: tuple[int, ...], dtype: Any = np.uint8
) -> Callable[[], NDArray[Any]]:
    """Makes an .npy file of zeros and allocates its disk space: a full disk raises OSError now, not
    a signal (SIGBUS) later.
    """
    np.lib.format.open_memmap(path, "w+", dtype, shape)
    reserve(path)
    return mapper(path)


def mapper(path: Path) -> Callable[[], NDArray[Any]]:
    """A function that maps the array of an .npy file for reading and writing in any thread. Call it
    for every block: touched pages count as memory of the process as long as the map exists.
    """
    # once: parsing a header in two threads occasionally fails (Python 3.11.7)
    array = np.lib.format.open_memmap(path, "r+")
    return partial(np.memmap, path, array.dtype, "r+", array.offset, array.shape)


def _mapped(path: Path, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """A read-only map of an .npy file. Raises OSError, and ValueError for another type or shape."""
    check_regular(path)
    array = np.lib.format.open_memmap(path, mode="r")
    if array.shape != shape or array.dtype != dtype or not array.flags.c_contiguous:
        raise ValueError(f"{path.name} is not an array of {np.dtype(dtype)} {shape}")
    return np.asarray(array)


def hold_pack(folder: Path) -> int:
    """An open descriptor of a pack: `lfpipe scene clean` does not remove the pack until it is
    closed.

    Raises OSError, and ValueError if the pack is being removed.
    """
    with open_regular(folder / VIEWS) as file:
        locked = lock_open(file.fileno(), shared=True)
        if not locked or not os.path.samestat(os.fstat(file.fileno()), (folder / VIEWS).stat()):
            raise ValueError("it is being removed")
        return os.dup(file.fileno())  # shares the lock


def open_pack(folder: Path, invert_depth: str = "auto") -> LightField:
    """The light field of a pack, in the order that scene.invert_depth asks for. `lfpipe scene
    clean` does not remove the pack while this object lives.

    Raises DamagedPackError if it is missing, damaged or of another version.
    """
    with _reading(folder), contextlib.ExitStack() as undo:
        lock = hold_pack(folder)
        undo.callback(os.close, lock)
        field = light_field(folder, read_manifest(folder))
        undo.pop_all()
        # locked as long as the map of the views lives
        hold = weakref.finalize(field.views.base, os.close, lock)
        return shown_as(attrs.evolve(field, hold=hold), invert_depth)


def light_field(folder: Path, manifest: Manifest) -> LightField:
    """The light field of a pack with this manifest.

    Raises OSError, ValueError and others if lfpipe did not write it.
    """
    disparity = None
    if manifest.complete and manifest.disparity.source is not DisparitySource.NONE:
        disparity = _mapped(folder / DISPARITY, manifest.disparity_shape, np.int8)
    return LightField.of(
        manifest,
        _mapped(folder / VIEWS, manifest.views_shape, np.uint8),
        disparity,
        folder=str(folder),
    )


def summarize(field: LightField) -> SceneSummary:
    """The summary of an opened pack for a session."""
    same = (
        *("name", "frames", "rows", "cols", "height_px", "width_px"),
        *("method", "complete", "depth_inverted", "needs_eyes"),
    )
    return SceneSummary(
        pack=field.folder,
        has_disparity=field.disparity is not None,
        scores=field.manifest.scores,
        errors=field.manifest.errors,
        disparity_min_px=field.disparity_min_px,
        disparity_max_px=field.disparity_max_px,
        **{name: getattr(field, name) for name in same},
    )


_KEY = re.compile("[0-9a-f]{24}")  # as `key_of` returns it


def cache_dir(scene: config.Scene) -> Path:
    """The cache: scene.cache_dir, or the user's cache directory. It need not exist."""
    return (
        Path(scene.cache_dir).expanduser()
        if scene.cache_dir
        else Path(platformdirs.user_cache_dir("lfpipe"))
    )


@contextlib.contextmanager
def writing(root: Path) -> Iterator[None]:
    """Turns write errors of the cache into UserError."""
    try:
        yield
    except OSError as error:
        raise UserError(
            f"cache directory {root}: {reason(error)}",
            "free some space, or use another one with --set scene.cache_dir=DIR",
        ) from None


def prepare_cache(scene: config.Scene) -> Path:
    """Creates the folders of the cache. Raises UserError if they are not writable."""
    root = cache_dir(scene)
    with writing(root):
        for name in ("scenes", "locks"):
            (root / name).mkdir(parents=True, exist_ok=True)
            if not os.access(root / name, os.W_OK):
                raise PermissionError(13, f"no permission to write to {name}")
    return root


def key_of(path: str | os.PathLike[str], scene: config.Scene) -> str:
    """Hash of the settings, and of names, sizes and times at path and some levels of subfolders:
    equal while nothing changes. Raises UserError.
    """
    used = attrs.asdict(
        scene, filter=lambda field, _: field.name not in ("cache_dir", "invert_depth")
    )
    text = json.dumps({"version": VERSION, **used}, sort_keys=True)
    digest = hashlib.blake2b(text.encode(), digest_size=12)
    listing = list_scene(path)
    digest.update(str(listing.path.resolve()).encode(errors="surrogateescape"))
    # a picture may be in a folder below those that are searched for one
    for entry in _entries(listing, 1 if listing.pictures() else DEEPEST + 1):
        with contextlib.suppress(OSError):
            state = entry.stat()
            digest.update(
                f"{entry}\0{state.st_size}\0{state.st_mtime_ns}\0".encode(errors="surrogateescape")
            )
    return digest.hexdigest()


def _entries(listing: Listing, deep: int) -> Iterator[Path]:
    """Files of a folder, and of `deep` levels of subfolders."""
    yield from (listing.folder / name for name in listing.names)
    for name in listing.folders if deep else ():
        with contextlib.suppress(UserError):
            yield from _entries(list_scene(listing.folder / name), deep - 1)


def usable(pack: Path, scene: config.Scene, *, complete: bool = False) -> LightField | None:
    """The light field of a pack; None if the pack is damaged or, with complete, has no disparity
    yet. All decisions on pack reuse are made here.
    """
    with contextlib.suppress(DamagedPackError):
        field = open_pack(pack, scene.invert_depth)
        return field if field.complete or not complete else None
    return None


def packed(
    path: str | os.PathLike[str], scene: config.Scene, *, complete: bool = False
) -> LightField | None:
    """As `usable`, for the path of a pack, of an unchanged scene, or of demo:NAME. Reads no
    picture. Raises UserError if there is no scene.
    """
    root = cache_dir(scene)
    path = named_scene(Path(path), root)
    places = (path, root / "scenes" / key_of(path, scene))
    fields = (usable(pack, scene, complete=complete) for pack in places if exists(pack / MANIFEST))
    return next(filter(None, fields), None)


@attrs.frozen(order=True)
class CachedPack:
    """A pack in the cache."""

    created: str  # "" if the manifest is unreadable
    folder: Path
    size_bytes: int
    manifest: Manifest | None = attrs.field(order=False)  # None if it is unreadable

    @property
    def names(self) -> set[str]:
        """The names that a user may give for it: its key, its name and its source."""
        about = self.manifest
        return {self.folder.name, *((about.name, about.source) if about else ())}


def packs(scene: config.Scene) -> list[CachedPack]:
    """Every pack, newest first."""
    listed = []
    for folder in (cache_dir(scene) / "scenes").glob("*/"):
        if not _KEY.fullmatch(folder.name) or folder.is_symlink():
            continue
        manifest = None
        with contextlib.suppress(DamagedPackError):
            manifest = read_manifest(folder)
        size_bytes = sum(file.lstat().st_size for file in folder.iterdir())
        listed.append(
            CachedPack(manifest.created if manifest else "", folder, size_bytes, manifest)
        )
    return sorted(listed, reverse=True)


def remove(folder: Path) -> bool:
    """Deletes a pack; returns False and keeps it if any process has it open or is writing it.

    Raises UserError.
    """
    root = folder.parents[1]
    # a concurrent `clean` may have removed it
    with writing(root), contextlib.suppress(FileNotFoundError), contextlib.ExitStack() as locks:
        for file in (root / "locks" / folder.name, folder / VIEWS):
            if (lock := lock_file(file)) is None:
                return False
            locks.callback(lock.release)
        shutil.rmtree(folder)
    return True


# several screens of thumbnails
COUNT = 40


def _file() -> Path:
    return Path(platformdirs.user_state_dir("lfpipe")) / "recent_scenes.json"


def recent_scenes() -> list[Path]:
    """The recent scenes that still exist."""
    texts: Any = None
    with contextlib.suppress(OSError, ValueError):
        texts = json.loads(read_bytes(_file()))
    if not isinstance(texts, list):
        return []
    paths = [Path(text) for text in texts if isinstance(text, str) and "\0" not in text]
    return [path for path in paths if exists(path)]


def remember_scene(path: Path) -> None:
    """Puts a scene first.

    Does nothing if the folder is not writable: the session goes on.
    """
    paths = dict.fromkeys(map(str, [path.resolve(), *recent_scenes()]))
    with contextlib.suppress(OSError):
        write_file(_file(), json.dumps([*paths][:COUNT]).encode())


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
    field = packed(paths[0], settings, complete=True)
    expand = expand and any(is_dir(path) and packed(path, settings) is None for path in paths)
    if field is not None and not expand:
        return Opened(paths, field)
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
    scene = find_packed(paths, settings, scorer=scorer, expand=False)
    if isinstance(scene, Opened):
        return scene.field
    _, summary = pack_until_shown(scene, progress, complete=True)
    return open_pack(Path(summary.pack), settings.invert_depth)


def ask_manifest(path: Path, settings: config.Scene, progress: Progress | None = None) -> Manifest:
    """The manifest of the scene at path. The packer analyses the scene but does not pack it.

    Raises UserError.
    """
    scenes = [named_scene(path, cache_dir(settings))]
    request = PackerRequest(do="info", scenes=scenes, settings=settings, expand=True)
    with contextlib.closing(Packing(request, progress)) as packing:
        packing.wait()
        return converter().structure(packing.result(), Manifest)
