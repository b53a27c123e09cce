"""`lfpipe bench viewer` in its short form: every figure of the product is within its bound."""

from lfpipe.bench.results import Results
from lfpipe.bench.viewer import tables
from lfpipe.bench.world.bounds import BOUNDS, beyond
from lfpipe.bench.world.scripts import scripts


def test_no_figure_is_beyond_its_bound() -> None:
    """Two pictures of each script; what `--check` prints, as in `tests/faults_noticed.py`."""
    assert {script.name for script in scripts()} <= set(BOUNDS)
    lines = beyond(Results("viewer", list(tables(2))))
    assert not lines, "\n".join(lines)
