"""References that were damaged by chance or on purpose: compared, or refused by file, field and value."""

import json
import random
import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.replays import compare as comparison
from lfpipe.replays.compare import compare
from lfpipe.replays.report import REPORT, TRACE
from lfpipe.replays.run import clear_out, update_reference
from lfpipe.sequence.packets import INDEX, PACKETS
from tests import hostile_files as hostile
from tests import hostile_sequences

REFERENCE = Path(__file__).parent / "reference"
FRAMES = 12


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first frames of the project's reference."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    shutil.copytree(REFERENCE, folder)
    lines = (folder / TRACE).read_text().splitlines(keepends=True)[:FRAMES]
    (folder / TRACE).write_text("".join(lines))
    report = json.loads((folder / REPORT).read_text())
    report["counts"]["pictures"] = FRAMES
    (folder / REPORT).write_text(json.dumps(report))
    return folder


def damage(rng: random.Random, folder: Path) -> str:
    """Damages one thing of a reference; returns which."""
    kind = rng.choice(("report", "report", "trace", "trace", "index", "pictures", "picture", "no file"))
    kept = folder / "pictures"
    if kind == "report":
        (folder / REPORT).write_bytes(hostile.damaged_json(rng, json.loads((folder / REPORT).read_text())))
    elif kind in ("trace", "index"):
        path = folder / TRACE if kind == "trace" else kept / INDEX
        path.write_bytes(hostile.damaged_lines(rng, [json.loads(line) for line in path.read_text().splitlines()]))
    elif kind == "pictures":
        (kept / PACKETS).write_bytes(hostile.damaged_bytes(rng, (kept / PACKETS).read_bytes()))
    elif kind == "picture":
        found = hostile_sequences.packets(kept)
        for at in range(3):
            found[at] = (found[at][0], hostile_sequences.hostile_picture(rng, found[at][1]))
        hostile_sequences.put_packets(kept, found)
    else:
        path = rng.choice((folder / REPORT, folder / TRACE, kept / INDEX, kept / PACKETS))
        hostile.NO_FILES[kind := rng.choice(sorted(hostile.NO_FILES))](path)
    return kind


@settings(max_examples=100)
@given(seed=st.integers(0, 2**32), moved=st.booleans())
def test_a_damaged_reference_is_compared_or_refused(run: Path, seed: int, moved: bool) -> None:
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as parent:
        reference, now = Path(parent) / "ref", Path(parent) / "now"
        shutil.copytree(run, reference)
        shutil.copytree(run, now)
        if moved:  # so that pictures are looked at
            lines = [json.loads(line) for line in (now / TRACE).read_text().splitlines()]
            (now / TRACE).write_text("".join(json.dumps({**line, "picture": f"{line['picture']}x"}) + "\n" for line in lines))
        what = damage(rng, reference)
        try:
            found = compare(reference, now)
        except UserError as error:
            assert str(reference) in error.message and error.remedy and len(str(error)) <= 2000, (what, error)
        else:
            text = "".join(map(str, found.differences)) + "".join(found.notes)
            assert len(text) < 40_000
            text.encode()


def test_a_reference_with_thousands_of_other_settings_is_told_in_a_few_lines(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "ref")
    report = json.loads((run / REPORT).read_text())
    report["config"] |= {"x" * 200 + str(n): {"k": "v" * 1000} for n in range(3626)}
    (tmp_path / "ref" / REPORT).write_text(json.dumps(report))
    with pytest.raises(UserError, match="bytes"):
        compare(tmp_path / "ref", run)
    report["config"] = json.loads((run / REPORT).read_text())["config"]  # keys of no effect are not compared
    report["plan"] = {f"x{n}": "v" * 50 for n in range(3626)}
    (tmp_path / "ref" / REPORT).write_text(json.dumps(report))
    found = [str(each) for each in compare(tmp_path / "ref", run).differences]
    assert len(found) == comparison.MOST_FIELDS + 1 and found[-1].endswith("more keys")


def test_an_update_without_room_leaves_the_reference(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "ref")
    before = {path.name: path.read_bytes() for path in (tmp_path / "ref").rglob("*") if path.is_file()}
    (tmp_path / "now").mkdir()
    (tmp_path / "now" / REPORT).write_text("{}")  # no trace: as if the disk were full there
    with pytest.raises(UserError, match="cannot be written"):
        update_reference(tmp_path / "ref", tmp_path / "now")
    assert {path.name: path.read_bytes() for path in (tmp_path / "ref").rglob("*") if path.is_file()} == before
    (tmp_path / "ref" / ".new").mkdir()  # of an update that was killed
    update_reference(tmp_path / "ref", run)
    assert sorted(path.name for path in (tmp_path / "ref").iterdir()) == ["pictures", REPORT, TRACE]


def test_results_that_are_links_go_without_what_they_lead_to(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "photo").touch()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "pictures").symlink_to(tmp_path / "mine")
    hostile.NO_FILES["link to itself"](tmp_path / "out" / REPORT)
    (tmp_path / "out" / (REPORT + ".turn")).unlink()
    clear_out(tmp_path / "out")
    assert (tmp_path / "mine" / "photo").exists() and not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("name", [REPORT, TRACE, "pictures", f"pictures/{INDEX}", f"pictures/{PACKETS}"])
def test_a_link_out_of_a_reference_is_not_followed(run: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(run, tmp_path / "ref")
    path = tmp_path / "ref" / name
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    path.symlink_to(run / name)
    with pytest.raises(UserError, match=f"{name}: a link to .*outside of the folder"):
        compare(tmp_path / "ref", run)
