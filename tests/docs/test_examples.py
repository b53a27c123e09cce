"""The example of docs/contracts.md reads a frame of a running session."""

import runpy
import time

import pytest

from tests.docs.conftest import blocks
from tests.support.world import World


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
