"""A scheduler that dies in the middle of a call."""

from collections.abc import Callable
from concurrent.futures import CancelledError
from types import SimpleNamespace
from typing import Any

import pytest
from distributed.comm.core import CommClosedError

from lfpipe.errors import UserError
from lfpipe.sweep.cell import Cell
from lfpipe.sweep.engine import Job, Sweep


class DyingClient:
    """Its connection is lost while the first result travels."""

    status, scheduler = "running", SimpleNamespace(identity=None)

    def __init__(self, error: Exception) -> None:
        self.error = error

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        return {"workers": {"tcp://a": {}}}

    def submit(self, *_: Any, **__: Any) -> Any:
        def add_done_callback(call: Callable[[Any], None]) -> None:
            call(future)

        def result() -> None:
            raise self.error

        future = SimpleNamespace(key="k-0", status="finished", result=result, add_done_callback=add_done_callback)
        return future

    def sync(self, *_: Any, **__: Any) -> None:
        raise OSError("not reachable")


@pytest.mark.parametrize("error", [CommClosedError("reset by peer"), CancelledError("k-0")])
def test_a_scheduler_that_dies_while_a_result_travels_is_gone(error: Exception) -> None:
    with pytest.raises(UserError, match=r"the scheduler is gone; finished cells are kept"):
        Sweep(DyingClient(error), "", lambda *_: None).run([Job(Cell("quality", "", "", (), key="k"))])  # type: ignore[arg-type]
