"""The cache of packs: addressed by path, sizes and times, written atomically, one writer at a time.

CACHE/scenes/KEY/      a pack (`pack`); an unfinished one has no manifest
CACHE/locks/KEY        lock of its writer
CACHE/arrays/          arrays that programs pass to the API
CACHE/demo-N/          demo scenes
CACHE/bench/           inputs of measurements

Nothing but packs is ever removed.
"""

import contextlib
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import attrs
import platformdirs

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.safe_files import reason
from lfpipe.host import file_lock
from lfpipe.host.files import exists
from lfpipe.scene.demo import named_scene
from lfpipe.scene.files import Listing, list_scene
from lfpipe.scene.lightfield import VERSION, LightField, Manifest
from lfpipe.scene.pack import (
    MANIFEST,
    VIEWS,
    DamagedPackError,
    open_pack,
    read_manifest,
)

_DEEPEST = 3  # levels of folders between the given one and its pictures
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
    for entry in _entries(listing, 1 if listing.pictures() else _DEEPEST):
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
    with writing(root), contextlib.suppress(FileNotFoundError), contextlib.ExitStack() as held:
        for file in (root / "locks" / folder.name, folder / VIEWS):
            if (lock := file_lock.take(file)) is None:
                return False
            held.callback(lock.release)
        shutil.rmtree(folder)
    return True


def sweep(scene: config.Scene) -> int:
    """Removes leftovers of killed packers and other versions; returns their number. Raises
    UserError.
    """
    return sum(remove(pack.folder) for pack in packs(scene) if pack.manifest is None)
