"""Every example of README and docs/ works: code runs, files are accepted; recipes run on a
session's data. Commands: test_commands.py.
"""

import json
import re
import runpy
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest

from lfpipe.eyes import EYES
from lfpipe.transport import ring
from tests.docs.conftest import PAGES, ROOT, blocks
from tests.support.world import World


def test_docs_blocks_of_data_are_well_formed() -> None:
    for page in PAGES:
        for block in blocks(page, "toml"):
            tomllib.loads(block)
        for block in blocks(page, "json"):
            json.loads(block)


@pytest.mark.nightly
def test_ring_example_reads_a_frame(
    live: World, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    example = next(block for block in blocks("docs/contracts.md") if "open_ring" in block)
    path = live.root / "ring_example.py"
    path.write_text(example.replace('"default"', f'"{live.name}"'))
    monkeypatch.setenv("LFPIPE_RUN_DIR", str(live.run_dir))
    runpy.run_path(str(path))
    seq, t_sensor_ns, _skipped, mean = capsys.readouterr().out.split()
    assert (
        int(seq) > 0
        and time.monotonic_ns() - int(t_sensor_ns) < 10_000_000_000
        and 0 < float(mean) < 255
    )


def test_contracts_say_where_the_parts_of_a_ring_are(tmp_path: Path) -> None:
    """The offsets of the page, against a ring that the code made."""
    page = (ROOT / "docs" / "contracts.md").read_text()
    table = page.partition("| at byte ")[2].partition("\n\n")[0]
    rows = [line.split("|")[1:3] for line in table.splitlines()[2:]]
    offsets = [[int(n) for n in re.findall(r"\d+", left)] for left, _ in rows]
    assert offsets == [
        [8, 16, 24, 32],
        [ring.PUBLISHED, ring.EPOCH],
        [ring.DESCRIPTION],
        [0],
        [8, 16, 24, 32],
        [40, 48, ring.SLOT_HEADER],
    ]
    path = tmp_path / "eyes.ring"
    memory = ring.create(path, ring.RingSpec((), EYES))
    try:
        writer, reader = ring.Writer(path), ring.Reader(path)
        writer.begin()
        writer.publish(7, 8, 9, epoch=3, kind=2)
        raw = bytes(memory.buf)
        first = ring.PAGE
        assert np.frombuffer(raw, "<i8", 4, 8).tolist()[:3] == [4, ring.PAGE, EYES.itemsize]
        assert np.frombuffer(raw, "<i8", 5, first).tolist() == [1, 7, 3, 8, 9]
        assert np.frombuffer(raw, "<i8", 1, first + 48)[0] == 2
        writer.close()
        reader.close()
    finally:
        memory.unlink()
        memory.close()
