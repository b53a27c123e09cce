"""Where cells run: no port is open to strangers; what dies, hangs or takes long is named."""

import psutil
import pytest

from lfpipe.errors import UserError
from lfpipe.extras.sweep import run, work
from lfpipe.extras.sweep.plan import Cell
from lfpipe.extras.sweep.results import DIED, FAILED, OK, Outcome
from lfpipe.extras.sweep.run import dask_workers, local_workers, run_cells
from lfpipe.extras.sweep.work import SweepOptions, measure_cell
from tests.support.world import until

CELLS = [
    Cell(subject=subject, sequence="", scene=f"/s{k}", key=f"k{k}")
    for k, subject in enumerate(["quality"] * 4 + ["table"] * 2)
]


def test_cells_beside_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """No port is open; a cell whose process dies runs again, alone, as timed cells do; what takes
    long is named.
    """
    monkeypatch.setattr(run, "FIRST_LINE_S", 0.2)
    tries: list[str] = []
    now: set[str] = set()
    beside: dict[str, set[str]] = {}
    done: dict[str, Outcome] = {}
    notices: list[str] = []

    def measured(cell: Cell, options: SweepOptions) -> Outcome:
        tries.append(cell.key)
        now.add(cell.key)
        beside[cell.key] = set(now)
        if cell.key == "k3":
            until(lambda: any("quality s3" in line for line in notices), "notice of k3")
        now.discard(cell.key)
        if cell.key == "k1":
            raise ArithmeticError("no root")
        return Outcome(
            cell,
            DIED if cell.key == "k0" or (cell.key == "k2" and tries.count("k2") == 1) else OK,
            "signal 9",
        )

    with local_workers(2, measured) as workers:
        run_cells(
            workers,
            CELLS,
            SweepOptions(60.0),
            lambda one: done.update({one.cell.key: one}),
            notices.append,
        )
        sockets = [
            one
            for one in psutil.Process().net_connections("inet")
            if one.status == psutil.CONN_LISTEN
        ]
        assert not sockets, "a stranger could run code"
    assert {key: one.state for key, one in done.items()} == {
        "k0": FAILED,
        "k1": FAILED,
        "k2": OK,
        "k3": OK,
        "k4": OK,
        "k5": OK,
    }
    assert done["k0"].reason == "signal 9, also alone" and "no root" in done["k1"].reason
    assert all(beside[key] == {key} for key in ("k0", "k2", "k4", "k5")) and tries[4:6] == [
        "k4",
        "k5",
    ]
    assert all("running:" in line for line in notices)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "127.0.0.1:9"])
def test_a_scheduler_without_tls_is_refused_unless_insecure(address: str) -> None:
    with pytest.raises(UserError, match="TLS") as caught, dask_workers(address):
        pass
    assert "--insecure" in caught.value.remedy


@pytest.mark.parametrize(
    ("code", "state", "reason"),
    [
        ("import time; time.sleep(600)", FAILED, "--limit"),
        ("import os; os.kill(os.getpid(), 9)", DIED, "signal 9"),
    ],
)
def test_a_cell_that_hangs_or_dies(
    code: str, state: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, "COMMAND", code)
    outcome = measure_cell(CELLS[0], SweepOptions(2.0))
    assert outcome.state == state and reason in outcome.reason
