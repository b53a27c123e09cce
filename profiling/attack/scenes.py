"""Scenes in every layout, damaged; the commands that read a scene."""

import contextlib
import os
import random
import shutil
from pathlib import Path

from profiling.attack import mutations
from profiling.attack.case import Case
from profiling.attack.hdf5 import damaged_hdf5, hostile_array_file
from profiling.attack.headers import claiming
from profiling.attack.templates import LAYOUTS

NAMES = (
    "auto", "hci", "hci-old", "hci-text", "stanford", "jpeg-pleno", "mat", "eslf", "mosaic", "mosaic-video", "numbered",
    "picture", "quilt", "rows-cols", "x", "",
)  # fmt: skip
TEXT = (".cfg", ".dat", ".pfm", ".ppm", ".xml", ".json")
COMMANDS = (
    ("info", "--json"),
    ("info",),
    ("pack", "--json"),
    ("plan", "--json"),
    ("view", "--row", "1", "--col", "0.5", "-o", "out.png"),
    ("sheet", "-o", "out.png"),
)


def _pick(rng: random.Random, folder: Path) -> Path:
    """One file, rather a special one than one of many views."""
    files = mutations.files_in(folder)
    special = [path for path in files if path.suffix in (".cfg", ".dat", ".pfm", ".bin", ".xml")]
    return rng.choice(special if special and rng.random() < 0.5 else files)


def _renamed(rng: random.Random, path: Path) -> None:
    """Another name: odd, of another place in the grid, or of another layout."""
    numbers = rng.choice(("0", "9999", "1" * 40, "-1", "00", "1e309", "nan", "03"))
    stem = path.name
    digits = [n for n, sign in enumerate(stem) if sign.isdigit()]
    if digits and rng.random() < 0.6:
        place = rng.choice(digits)
        name = os.fsencode(stem[:place] + numbers + stem[place + 1 :])
    else:
        name = rng.choice(
            (
                mutations.odd_name(rng) + os.fsencode(path.suffix),
                b"parameters.cfg",
                b"attributes.dat",
                b"lf.h5",
                b"a.mat",
                b"x_qs9x9a1.png",
                b"gt_disp_lowres.pfm",
            )
        )  # fmt: skip
    target = os.path.join(os.fsencode(path.parent), name)[:4000]  # noqa: PTH118
    if len(name) <= 255 and not os.path.lexists(target):
        with contextlib.suppress(OSError):  # a name of several folders
            os.rename(path, target)  # noqa: PTH104


def _damage(rng: random.Random, scene: Path) -> str:
    """Does one thing to a scene; returns what, in a few words."""
    path = _pick(rng, scene)
    kind = rng.choices(
        ("bytes", "numbers", "header", "kind", "name", "more", "gone", "swapped", "grown", "array"),
        (24, 18, 18, 10, 8, 4, 3, 4, 3, 8),
    )[0]
    match kind:
        case "numbers" if path.suffix in TEXT:
            path.write_bytes(mutations.changed_numbers(rng, mutations.read(path)))
        case "header":
            path.write_bytes(claiming(rng, path.suffix))
        case "kind":
            return f"a {mutations.changed_kind(rng, path)} for a file"
        case "name":
            _renamed(rng, path)
        case "more":
            for n in range(rng.choice((1, 30))):
                shutil.copyfile(path, path.with_name(f"{path.stem}{n}{path.suffix}"))
        case "gone":
            path.unlink()
        case "swapped":
            path.write_bytes(mutations.read(_pick(rng, scene)))
        case "grown":
            mutations.grown(rng, path)
        case "array" if path.suffix in (".h5", ".mat"):
            damaged_hdf5(rng, path)
        case "array" if rng.random() < 0.3:
            hostile_array_file(rng, scene)
        case _:
            kind = "bytes"
            path.write_bytes(mutations.changed_bytes(rng, mutations.read(path)))
    return kind


def _options(rng: random.Random) -> list[str]:
    """What the user may say about the scene, rightly or not."""
    return rng.choice(
        (
            ["--layout", rng.choice(NAMES)],
            ["--grid", rng.choice(("3x3", "1x9", "9x1", "0x3", "9999x9999", "3", "x", "٣x٣", "2x2", "1x1", "64x64"))],
            ["--flip", rng.choice(("none", "rows", "both", "x"))],
            ["--transpose"],
            ["--gamma", rng.choice(mutations.NUMBERS)[:50]],
            ["--set", f"scene.gamma={rng.choice(mutations.NUMBERS)[:50]}"],
            ["--set", f"render.alpha_px={rng.choice(mutations.NUMBERS)[:50]}"],
        )
    )  # fmt: skip


def make(rng: random.Random, folder: Path, templates: Path) -> Case:
    """A damaged scene in folder/scene, and a command that reads it."""
    layout = rng.choice(LAYOUTS).__name__
    scene = folder / "scene"
    shutil.copytree(templates / layout, scene)
    kinds = [_damage(rng, scene)]
    while rng.random() < 0.25 and mutations.files_in(scene):
        kinds.append(_damage(rng, scene))
    unprivileged = rng.random() < 0.05
    if unprivileged:
        kinds = ["permissions"]
        victim = rng.choice([scene, *scene.rglob("*")])
        if not victim.is_symlink():
            victim.chmod(rng.choice((0o000, 0o200, 0o100, 0o444)))
    inside = [path for path in scene.rglob("*") if not path.is_dir()] if not unprivileged else []
    target = rng.choice(inside) if inside and rng.random() < 0.15 else scene
    word, *rest = rng.choices(COMMANDS, (8, 1, 4, 1, 1, 1))[0]
    argv = ["scene", word, *rest, *(_options(rng) if rng.random() < 0.2 else []), "--", str(target.relative_to(folder))]
    left = ("out*", "cache/lfpipe/scenes/.*", *(["cache/lfpipe/scenes/*"] if word in ("info", "pack") else []))
    return Case(f"{layout.replace('_', '-')}: {kinds[0]}", argv, left, unprivileged=unprivileged)
