"""Each remedy of the layouts that hold all views in one file, or that name them in three digits, opens the scene."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from lfpipe import config
from lfpipe.scene.truth import without_implausible_truth
from tests.scene import made
from tests.scene.test_remedies import AUTO, Cure, Make, Refused, again, both, grid, inside, require_cured, without

GRID = made.views(3, 4, 24, 32)
PLENO, TEXT = "{r:03d}_{c:03d}.png", "scene/lf/{r:02d}_{c:02d}.png"


def h5(name: str = "lf.h5", key: str = "LF", values: np.ndarray = GRID, **more: object) -> Make:
    def make(folder: Path) -> Path:
        with h5py.File(folder / name, "w") as file:
            file.create_dataset(key, data=values, **more)
        return folder

    return make


def mat(name: str = "s__Decoded.mat", key: str = "LF", values: np.ndarray = GRID) -> Make:
    return lambda folder: [scipy.io.savemat(folder / name, {key: values}), folder][1]


def elsewhere(kind: type) -> Make:
    def make(folder: Path) -> Path:
        with h5py.File(folder / "lf.h5", "w") as file:
            file["LF"] = kind("other.h5", "LF") if kind is h5py.ExternalLink else kind("/elsewhere")
        return folder

    return make


def cut(make: Make, name: str, share: float) -> Make:
    """A file of which only the first part is there."""

    def short(folder: Path) -> Path:
        path = make(folder) / name
        path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
        return folder

    return short


def saved(make: Make) -> Cure:
    """The file written once more, as the remedy says."""

    def cure(path: Path) -> tuple[Path, config.Scene]:
        for old in path.glob("*.*"):
            old.unlink()
        return make(path), AUTO

    return cure


def text(attributes: str = "1 //dH\n2 //focalLength\n", depth: bytes = b"", *gone: str) -> Make:
    """The first HCI data set as text and pictures."""

    def make(folder: Path) -> Path:
        made.write_grid(folder, GRID, TEXT)
        (folder / "scene" / "attributes.dat").write_text(attributes)
        if depth:
            (folder / "scene" / "depth.bin").write_bytes(depth)
        for name in gone:
            (folder / "scene" / name).unlink()
        return folder / "scene"

    return make


def rewritten(name: str, content: str) -> Cure:
    return lambda path: [(path / name).write_text(content), (path, AUTO)][1]


WRONG_AXES = np.zeros((3, 4, 24), np.uint8)
REFUSALS = {
    "h5: two files": Refused(both(h5("a.h5"), h5("b.h5")), "by its own path", inside("a.h5")),
    "h5: another name": Refused(h5(key="views"), "as LF", saved(h5())),
    "h5: wrong axes": Refused(h5(values=WRONG_AXES), "with these axes", saved(h5())),
    "h5: damaged": Refused(cut(h5(), "lf.h5", 0.5), "again", saved(h5())),
    "h5: a link outwards": Refused(elsewhere(h5py.ExternalLink), "as one file", saved(h5())),
    "h5: a link within": Refused(elsewhere(h5py.SoftLink), "as one file", saved(h5())),
    "h5: whole numbers": Refused(h5(values=GRID.astype(np.int32)), "uint8, uint16 or float", saved(h5(values=GRID / 255))),
    "h5: NaN": Refused(h5(values=np.full((3, 4, 24, 32, 3), np.nan)), "export it again", saved(h5(values=GRID / 255))),
    "mat: two files": Refused(both(mat("a.mat"), mat("b.mat")), "by its own path", inside("b.mat")),
    "mat: another name": Refused(mat(key="views"), "as LF", saved(mat())),
    "mat: another name, 7.3": Refused(h5("a.mat", "views"), "as LF", saved(h5("a.mat"))),
    "mat: wrong axes": Refused(mat(values=WRONG_AXES), "with these axes", saved(mat())),
    "mat: damaged": Refused(cut(mat(), "s__Decoded.mat", 0.7), "again", saved(mat())),
    "mat: another format": Refused(lambda f: [(f / "a.mat").write_bytes(b"x" * 500), f][1], "-v7.3", saved(mat())),
    "mat: texts": Refused(mat(values=np.full((3, 4, 24, 32), "x")), "uint8, uint16 or float", saved(mat())),
    "jpeg-pleno: a view missing": Refused(
        grid(PLENO, "001_001.png"), "--layout rows-cols", again(layout="rows-cols")
    ),
    "jpeg-pleno: views of two scenes": Refused(
        both(grid(PLENO), grid("{r:03d}_9{c:02d}.png", views=GRID[:1, :1])), "of only one scene", without("000_900.png")
    ),
    "jpeg-pleno: other names": Refused(
        grid("v_{r}_{c}.png"), "leave out --layout", again(), config.Scene(layout="jpeg-pleno")
    ),
    "hci-text: a view missing": Refused(text("", b"", "lf/01_01.png"), "--layout rows-cols", again(layout="rows-cols")),
    "hci-text: too few views": Refused(text("9 //vRes\n9 //hRes\n"), "--layout rows-cols", again(layout="rows-cols")),
    "hci-text: no attributes": Refused(
        lambda folder: text()(folder) / "lf", "the folder that contains both", lambda path: (path.parent, AUTO),
        config.Scene(layout="hci-text"),
    ),
    "hci-text: a number out of range": Refused(text("1e30 //dH\n"), "correct the value", rewritten("attributes.dat", "1 //dH\n")),
    "hci-text: depth of another size": Refused(text(depth=b"1234"), "move it away", without("depth.bin")),
    "hci-text: depth that is none": Refused(text(depth=b"\xff" * 4 * 24 * 32), "remove the map", without("depth.bin")),
    "hci-text: no views": Refused(
        lambda f: [text()(f), [p.rename(p.with_suffix(".x")) for p in (f / "scene" / "lf").glob("*")], f / "scene"][2],
        "download the scene again", lambda path: [made.write_grid(path / "lf", GRID, "{r}_{c}.png"), (path, AUTO)][1],
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSALS)
def test_the_remedy_opens_the_scene(tmp_path: Path, kind: str) -> None:
    require_cured(tmp_path / "scene", REFUSALS[kind], lambda source, _: without_implausible_truth(source))
