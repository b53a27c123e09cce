"""Runs cells on Dask distributed: on a local cluster, or on any scheduler by its address.

Timed cells need the resource `quiet` and run after all others, one per host at a time. If a worker dies, its cells are tried
again.
"""

import contextlib
import logging
import queue
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from typing import Any

import attrs
import dask
from distributed import Client, Future, LocalCluster
from distributed.scheduler import KilledWorker

from lfpipe.bench.results import source_digest
from lfpipe.errors import UserError
from lfpipe.sweep.cell import FAILED, Cell, Outcome, outcome
from lfpipe.sweep.work import Parcel, do_cell, packed

QUIET = "quiet"
TRIES = 3  # deaths of workers that a cell survives
IN_FLIGHT = 32  # cells per worker that the scheduler knows of; limits its memory
AGAIN = "start it again, then run the same command"
SCHEDULER_WAIT_S = 8.0
WORKER_WAIT_S = 30.0
SETTINGS = {
    "distributed.scheduler.allowed-failures": TRIES,
    "distributed.worker.daemon": False,  # replays start processes of their own
    "distributed.comm.timeouts.connect": f"{SCHEDULER_WAIT_S:g}s",
    "distributed.scheduler.worker-ttl": "5 minutes",
    "distributed.admin.large-graph-warning-threshold": "1GB",
}
Done = Callable[[Outcome, bytes], None]


@attrs.frozen
class Job:
    """A cell with what it needs. reference: tar of a replay to compare with, read when the cell is sent."""

    cell: Cell
    reference: Callable[[], bytes] = bytes
    update: bool = False


@contextlib.contextmanager
def cluster(address: str, jobs: int) -> Iterator[Client]:
    """A client of the scheduler at address, or of a local cluster with `jobs` workers if address is "". Raises UserError."""
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # we report errors ourselves
    with dask.config.set(SETTINGS), contextlib.ExitStack() as stack:
        if address:
            try:
                client = stack.enter_context(Client(address, timeout=SCHEDULER_WAIT_S, set_as_default=False))
                client.wait_for_workers(1, timeout=WORKER_WAIT_S)
            except (OSError, ValueError, TimeoutError) as error:
                why = str(error).splitlines()[0] if str(error) else type(error).__name__
                remedy = "start `dask scheduler` and, on each host, `dask worker ADDRESS --nthreads 1 --resources quiet=1`"
                raise UserError(f"--on {address}: {why}", remedy) from None
            other = {name for name, digest in client.run(source_digest).items() if digest != source_digest()}
            if other:
                raise UserError(f"--on {address}: {min(other)} runs another lfpipe", "install the same version on all hosts")
        else:
            local = LocalCluster(
                n_workers=jobs, threads_per_worker=1, processes=True, resources={QUIET: 1}, dashboard_address=None,
                silence_logs=50, host="127.0.0.1", memory_limit=0,
            )  # fmt: skip
            stack.enter_context(local)
            client = stack.enter_context(Client(local, set_as_default=False))
        yield client


class Sweep:
    """Sends jobs to the cluster and takes their outcomes. work: measures a cell; always `do_cell` except in tests."""

    def __init__(self, client: Client, address: str, done: Done, work: Callable[..., tuple[Outcome, bytes]] = do_cell) -> None:
        self._client, self._address, self._done, self._work = client, address, done, work
        self._answers: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._open: dict[str, tuple[Job, Future, int, str]] = {}  # with tries and, of a timed cell, its host
        self._parcels: dict[str, Any] = {}

    def run(self, jobs: Iterable[Job]) -> None:
        """Shared cells first, then timed ones. Raises UserError if the scheduler or all workers are gone."""
        try:
            self._run(list(jobs))
        except (OSError, CancelledError):  # a connection lost in the middle of a call
            if self._reachable():
                raise
            raise self._gone() from None

    def _run(self, every: list[Job]) -> None:
        timed = [job for job in every if job.cell.timed]
        self._phase(job for job in every if not job.cell.timed)
        if timed and not any(QUIET in worker.get("resources", {}) for worker in self._workers().values()):
            for job in timed:
                why = f"no worker has the resource {QUIET}: start one per host with --resources {QUIET}=1"
                self._done(outcome(job.cell, FAILED, why), b"")
            return
        self._phase(iter(timed), alone=True)

    def _workers(self) -> dict[str, Any]:
        return dict(self._client.scheduler_info(n_workers=-1)["workers"])

    def _quiet_hosts(self) -> dict[str, list[str]]:
        """Host -> addresses of its workers that take timed cells."""
        hosts: dict[str, list[str]] = {}
        for address, worker in self._workers().items():
            if QUIET in worker.get("resources", {}):
                hosts.setdefault(worker["host"], []).append(address)
        return hosts

    def _phase(self, jobs: Iterator[Job], alone: bool = False) -> None:
        """Sends jobs as there is room. alone: one per host, or the scheduler would queue all on the host that answers first."""
        more = True
        room = IN_FLIGHT * max(1, len(self._workers()))
        while more or self._open:
            while more and len(self._open) < (max(1, len(self._quiet_hosts())) if alone else room):
                job = next(jobs, None)
                more = job is not None
                if job is not None:
                    self._send(job, 0)
            if self._open:
                self._take()

    def _parcel(self, path: str, digest: str) -> Any:
        """The parcel for a path. Small contents are sent once to each worker of a cluster."""
        if not self._address:
            return Parcel(path)
        if path not in self._parcels:
            try:
                parcel = packed(path, digest)
            except OSError:  # the worker reports the error
                parcel = Parcel(path)
            self._parcels[path] = self._client.scatter(parcel, broadcast=True) if parcel.tar else parcel
        return self._parcels[path]

    def _send(self, job: Job, tries: int) -> None:
        from lfpipe.sweep.plan import scene_id, sequence_id

        cell = job.cell
        sequence = self._parcel(cell.sequence, sequence_id(cell.sequence) if self._address else "")
        scene = self._parcel(cell.scene, scene_id(cell.scene, cell.sets) if self._address else "")
        hosts = self._quiet_hosts() if cell.timed else {}
        busy = [host for *_, host in self._open.values()]
        host = min(hosts, key=busy.count, default="")
        future = self._client.submit(
            self._work, cell, sequence, scene, job.reference(), job.update, key=f"{cell.key}-{tries}", pure=False,
            resources={QUIET: 1} if cell.timed else None, workers=hosts.get(host), allow_other_workers=bool(host),
        )  # fmt: skip
        self._open[future.key] = job, future, tries, host
        future.add_done_callback(self._answers.put)

    def _take(self) -> None:
        """Waits for an answer. Raises UserError if none can come."""
        began = time.monotonic()
        while True:
            try:
                future = self._answers.get(timeout=1.0)
                break
            except queue.Empty:
                if self._client.status not in ("running", "connecting"):
                    raise self._gone() from None
                if time.monotonic() - began > WORKER_WAIT_S and self._client.status == "running" and not self._workers():
                    raise UserError("all workers are gone; finished cells are kept", AGAIN) from None
        job, _, tries, _ = self._open.pop(future.key)
        if future.status == "finished":
            found, new = future.result()
            self._done(found, new)
        elif future.status == "error" and isinstance(future.exception(), KilledWorker):
            self._done(outcome(job.cell, FAILED, f"its worker died {TRIES + 1} times: out of memory, or a crash"), b"")
        elif future.status == "error":
            self._done(outcome(job.cell, FAILED, f"{type(future.exception()).__name__}: {future.exception()}"), b"")
        elif self._client.status != "running" or not self._reachable():
            raise self._gone()
        elif tries < TRIES:  # data sent with it is lost with its worker
            self._parcels.clear()
            self._send(job, tries + 1)
        else:
            self._done(outcome(job.cell, FAILED, "lost by the scheduler"), b"")

    def _reachable(self) -> bool:
        try:
            self._client.sync(self._client.scheduler.identity, n_workers=0)
        except Exception:  # every kind of lost connection
            return False
        return True

    def _gone(self) -> UserError:
        where = f"the scheduler at {self._address}" if self._address else "the scheduler"
        return UserError(f"{where} is gone; finished cells are kept", AGAIN)
