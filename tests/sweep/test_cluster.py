"""The cluster of a sweep: who has no certificate runs nothing on it; who dies, hangs or waits is named."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from lfpipe.errors import UserError
from lfpipe.sweep import run, work
from lfpipe.sweep.plan import Cell
from lfpipe.sweep.results import DIED, FAILED, OK, Outcome
from lfpipe.sweep.run import Sweep, cluster
from lfpipe.sweep.work import Order, outcome_of
from tests.sweep.conftest import write_wall

CLIENT = "import sys; from distributed import Client; Client(sys.argv[1], timeout=4).run(lambda: open(sys.argv[2], 'w').close())"
CELLS = [Cell("quality", "", f"/s{k}", (), key=f"k{k}") for k in range(5)]


def measured(cell: Cell, order: Order) -> Outcome:
    """Stands for a measurement; what it does depends on the scene's name, the folder is given as the reference."""
    tries = Path(order.reference) / f"{cell.key}-{time.monotonic_ns()}"
    tries.touch()
    if cell.key == "k1":  # kills the worker, whenever it runs
        os.kill(os.getpid(), signal.SIGKILL)
    if cell.key == "k2":  # its process dies once, beside others
        return Outcome(cell, DIED if len(list(tries.parent.glob("k2-*"))) == 1 else OK, "signal 9")
    if cell.key == "k3":
        end = time.monotonic() + 30
        while not (tries.parent / "named").exists() and time.monotonic() < end:
            time.sleep(0.05)
    return Outcome(cell, OK)


def test_a_local_cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One real cluster for all: strangers; a cell that crashes its worker condemns no other one; what takes long is named."""
    monkeypatch.setattr(run, "FIRST_LINE_S", 0.5)
    done: dict[str, Outcome] = {}
    notices: list[str] = []

    def notice(line: str) -> None:
        notices.append(line)
        if "quality s3" in line:
            (tmp_path / "tries" / "named").touch()

    with cluster("", 2) as client:
        everyone = [psutil.Process(), *psutil.Process().children(recursive=True)]
        ports = {c.laddr.port for p in everyone for c in p.net_connections("inet") if c.status == psutil.CONN_LISTEN}
        assert len(ports) >= 5, "scheduler, workers and nannies"
        scheduler = int(client.scheduler.address.rsplit(":", 1)[1])
        marks = {f"{protocol}://127.0.0.1:{scheduler}": tmp_path / protocol for protocol in ("tcp", "tls")}
        strangers = [subprocess.Popen([sys.executable, "-c", CLIENT, *map(str, pair)], stderr=-3) for pair in marks.items()]
        assert all(client.run(lambda path=tmp_path / "mine": path.touch() or True).values()) and (tmp_path / "mine").exists()
        (tmp_path / "tries").mkdir()
        order = Order(60.0, str(tmp_path / "tries"))
        Sweep(client, lambda one: done.update({one.cell.key: one}), lambda _: order, notice, measured).run(CELLS)
        for stranger in strangers:
            try:
                assert stranger.wait(20) != 0
            except subprocess.TimeoutExpired:
                stranger.kill()
                stranger.wait()
        assert not any(mark.exists() for mark in marks.values()), "a client without certificates ran code"
    assert {key: one.state for key, one in done.items()} == {"k0": OK, "k1": FAILED, "k2": OK, "k3": OK, "k4": OK}
    assert "died" in done["k1"].reason and "alone" in done["k1"].reason
    assert any("running:" in line and "quality s3" in line for line in notices), notices


@pytest.mark.live
def test_a_scheduler_without_tls_is_refused_unless_insecure() -> None:
    for address in ("tcp://127.0.0.1:9", "127.0.0.1:9"):
        with pytest.raises(UserError) as caught, cluster(address, 1):
            pass
        assert "TLS" in caught.value.message and "--insecure" in caught.value.remedy
    with pytest.raises(UserError, match="tcp://127") as caught, cluster("tcp://127.0.0.1:9", 1, insecure=True):
        pass
    assert "TLS" not in caught.value.message


def test_a_cell_that_hangs_ends_at_its_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "COMMAND", "import time; time.sleep(60)")
    began = time.monotonic()
    outcome = outcome_of(CELLS[0], Order(1.0))
    assert outcome.state == FAILED and "--limit" in outcome.reason and time.monotonic() - began < 20


def test_a_cell_whose_process_is_killed_is_a_suspect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "COMMAND", "import os; os.kill(os.getpid(), 9)")
    outcome = outcome_of(CELLS[0], Order(60.0))
    assert outcome.state == DIED and "signal 9" in outcome.reason


@pytest.mark.live
def test_a_subject_of_the_benchmark_as_a_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    scene = write_wall(tmp_path / "wall", 0)
    outcome = outcome_of(Cell("anaglyph", "", str(scene), (), key="k"), Order(100.0))
    assert outcome.state == OK and outcome.figures, outcome.reason
