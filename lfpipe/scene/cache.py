"""The cache of packs: addressed by content, written atomically, one writer at a time.

CACHE/scenes/KEY/      a pack (`pack`); an unfinished one has no manifest
CACHE/locks/KEY        lock of its writer
CACHE/index/STAMP      text: the KEY of a path whose names, sizes and times have this stamp
CACHE/arrays/          arrays that programs pass to the API
CACHE/demo-N/          demo scenes
CACHE/bench/           inputs of measurements

Nothing else is ever removed. A scene.cache_dir that contains anything else is refused.
"""

import contextlib
import errno
import hashlib
import json
import os
import re
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

import attrs
import platformdirs

from lfpipe import config
from lfpipe.errors import UserError, quoted
from lfpipe.files.safe_files import WORK_NAME, open_file, read_bytes, reason, write_file
from lfpipe.host import file_lock
from lfpipe.host.files import exists, is_dir
from lfpipe.scene.demo import named_scene
from lfpipe.scene.files import Listing, list_scene
from lfpipe.scene.lightfield import VERSION, LightField, Manifest
from lfpipe.scene.pack import (
    FILES,
    MANIFEST,
    VIEWS,
    DamagedPackError,
    open_pack,
    read_manifest,
)
from lfpipe.scene.source import SceneSource

_DEEPEST = 3  # levels of folders between the given one and its pictures
_KEY = re.compile("[0-9a-f]{24}")  # as `content_key` returns it
_STAMP = re.compile("[0-9a-f]{32}")
_HIDDEN = r"|\..*"  # of the system, or a work name
_CONTENTS = {  # names by folder
    # a home directory may have hidden files only
    "": re.compile(r"scenes|locks|index|arrays|bench|demo-\d+|lost\+found|\.DS_Store|\.nfs\w+"),
    "scenes": re.compile(_KEY.pattern + _HIDDEN),
    "locks": re.compile(_KEY.pattern + _HIDDEN),
    "index": re.compile(_STAMP.pattern + r"(\..*)?" + _HIDDEN),
    "arrays": re.compile(r"array-[0-9a-f]{20}\.np[yz]" + _HIDDEN),
}


def cache_root(scene: config.Scene) -> Path:
    """As `cache_dir`, without a check of its content."""
    return (
        Path(scene.cache_dir).expanduser()
        if scene.cache_dir
        else Path(platformdirs.user_cache_dir("lfpipe"))
    )


def cache_dir(scene: config.Scene) -> Path:
    """The cache: scene.cache_dir, or the user's cache directory. It need not exist.

    Raises UserError if scene.cache_dir contains anything but a cache.
    """
    root = cache_root(scene)
    with writing(root):
        for name, known in _CONTENTS.items() if scene.cache_dir else ():
            folder = root / name
            for path in folder.iterdir() if is_dir(folder) else ():
                if not known.fullmatch(path.name):
                    foreign = quoted(str(path.relative_to(root)))
                    raise UserError(
                        f"scene.cache_dir {root}: holds {foreign}, which does not belong to"
                        " lfpipe's cache",
                        "name a new folder: --set scene.cache_dir=DIR",
                    )
    return root


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
        for name in ("scenes", "locks", "index"):
            (root / name).mkdir(parents=True, exist_ok=True)
            if not os.access(root / name, os.W_OK):
                raise PermissionError(13, f"no permission to write to {name}")
    return root


def _settings_key(scene: config.Scene) -> str:
    """The settings that a pack depends on, as text for a hash."""
    used = {
        key: value
        for key, value in attrs.asdict(scene).items()
        if key not in ("cache_dir", "force", "invert_depth")
    }
    return json.dumps({"version": VERSION, **used}, sort_keys=True)


def stamp(path: str | os.PathLike[str], scene: config.Scene) -> str:
    """Hash of names, sizes and times at path and some levels of subfolders: equal while nothing
    changes. Raises UserError.
    """
    digest = hashlib.blake2b(_settings_key(scene).encode(), digest_size=16)
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


def content_key(source: SceneSource, scene: config.Scene) -> str:
    """Hash of the contents of the source's files, its layout and the settings.

    Raises UserError or OSError.
    """
    digest = hashlib.blake2b(f"{_settings_key(scene)}{source.layout}".encode(), digest_size=12)
    for path in source.files:
        with open_file(path) as stream:
            size = os.fstat(stream.fileno()).st_size
            digest.update(f"\0{path.name}\0{size}\0".encode(errors="surrogateescape"))
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _pack_of(entry: Path, root: Path) -> Path | None:
    """The pack that an entry of the index names, if it exists."""
    with contextlib.suppress(OSError, UnicodeDecodeError):
        key = read_bytes(entry, 256).decode()
        if key.isalnum() and (root / "scenes" / key).is_dir():
            return root / "scenes" / key
    return None


def find_pack(path: str | os.PathLike[str], scene: config.Scene) -> Path | None:
    """The pack of an unchanged scene, or None; reads no picture.

    Raises UserError if there is no scene.
    """
    root = cache_dir(scene)
    return _pack_of(root / "index" / stamp(path, scene), root)


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
    path = named_scene(Path(path), cache_dir(scene))
    own = path if exists(path / MANIFEST) else None
    fields = (
        usable(pack, scene, complete=complete) for pack in (own, find_pack(path, scene)) if pack
    )
    return next(filter(None, fields), None)


def remember(root: Path, mark: str, key: str) -> None:
    """Records in the index that the path with this stamp has that pack.

    Raises UserError if the disk is full.
    """
    with writing(root):
        write_file(root / "index" / mark, key.encode(), 0o666)


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


def _is_pack(folder: Path) -> bool:
    """Whether a folder contains a pack, even an unfinished or damaged one, and nothing else."""
    return (
        bool(_KEY.fullmatch(folder.name))
        and not folder.is_symlink()
        and all(
            stat.S_ISREG(file.lstat().st_mode)
            and (file.name in FILES or bool(WORK_NAME.fullmatch(file.name)))
            for file in folder.iterdir()
        )
    )


def clear(folder: Path) -> None:
    """Removes a pack, if it exists. Raises OSError, also if the folder contains anything else."""
    if os.path.lexists(folder):
        if not _is_pack(folder):
            raise FileExistsError(errno.EEXIST, "exists, but is not a pack", str(folder))
        shutil.rmtree(folder)


def remove(folder: Path) -> bool:
    """Deletes a pack; returns False and keeps it if any process has it open or is writing it, or
    if the folder contains anything else.

    Raises UserError.
    """
    root = folder.parents[1]
    # a concurrent `clean` may have removed it
    with writing(root), contextlib.suppress(FileNotFoundError), contextlib.ExitStack() as held:
        if not _is_pack(folder):
            return False
        for file in (root / "locks" / folder.name, folder / VIEWS):
            if (lock := file_lock.take(file)) is None:
                return False
            held.callback(lock.release)
        clear(folder)
    return True


def sweep(scene: config.Scene) -> int:
    """Removes leftovers of killed packers and other versions, and index entries without a pack.
    Returns the number removed. Raises UserError.
    """
    removed = sum(remove(pack.folder) for pack in packs(scene) if pack.manifest is None)
    root = cache_dir(scene)
    for entry in (root / "index").iterdir() if (root / "index").is_dir() else ():
        ours = _STAMP.fullmatch(entry.name) or WORK_NAME.fullmatch(entry.name)
        with contextlib.suppress(OSError):
            if ours and _pack_of(entry, root) is None:
                entry.unlink()
                removed += 1
    return removed
