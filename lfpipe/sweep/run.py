"""Runs a sweep on Dask distributed: on a local cluster, or on any scheduler by its address.

Timed cells need the resource `quiet` and run after all others, one per host at a time. A cell whose process died runs again,
alone, at the end.
"""

import contextlib
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from pathlib import Path

import attrs
import dask
from distributed import Client, Future, LocalCluster, Security, as_completed
from distributed.scheduler import KilledWorker

from lfpipe.bench.conditions import source_digest
from lfpipe.errors import UserError
from lfpipe.host.files import is_dir
from lfpipe.host.machine import versions
from lfpipe.sweep.cell import DIED, DONE, FAILED, REPLAY, Cell, Outcome
from lfpipe.sweep.plan import Plan, cells
from lfpipe.sweep.references import judged, marked, place_of
from lfpipe.sweep.results import Store
from lfpipe.sweep.work import TOPIC, Order, measure_cell

QUIET = "quiet"
TRIES = 3  # deaths of workers that a cell survives
AGAIN = "start it again, then run the same command"
SCHEDULER_WAIT_S, WORKER_WAIT_S = 8.0, 30.0
FIRST_LINE_S = 30.0  # a cell that runs longer is named; again after twice that time, and so on
SETTINGS = {
    "distributed.scheduler.allowed-failures": TRIES,
    "distributed.worker.daemon": False,  # replays start processes of their own
    "distributed.comm.timeouts.connect": f"{SCHEDULER_WAIT_S:g}s",
    "distributed.scheduler.worker-ttl": "5 minutes",
}
log = logging.getLogger(__name__)


@attrs.frozen
class Options:
    """address: of a scheduler, "" for a local cluster of `jobs` workers. limit_s: of a cell. expect: folder of the references,
    None without; update: write them. progress: (what, done, total). notice: receives lines for the user."""

    address: str
    jobs: int
    limit_s: float
    expect: Path | None
    update: bool
    insecure: bool
    progress: Callable[[str, int, int], None]
    notice: Callable[[str], None]


@contextlib.contextmanager
def cluster(address: str, jobs: int, insecure: bool = False) -> Iterator[Client]:
    """A client of the scheduler at address, or of a local cluster with `jobs` workers if address is "".

    Dask runs whatever code it receives, so both need certificates: a local cluster those of this run, in memory; a remote one
    those of Dask's configuration. insecure: connect without. Raises UserError.
    """
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # we report errors ourselves
    if address and not address.startswith("tls://") and not insecure:
        what = f"--on {address}: without TLS, whoever reaches this port runs code as you: Dask unpickles what it receives"
        raise UserError(what, "start Dask with certificates and name tls://HOST:PORT; on a network of your own, add --insecure")
    with dask.config.set(SETTINGS), contextlib.ExitStack() as stack:
        if address:
            try:
                client = stack.enter_context(Client(address, timeout=SCHEDULER_WAIT_S, set_as_default=False))
                client.wait_for_workers(1, timeout=WORKER_WAIT_S)
            except (OSError, ValueError, TypeError, TimeoutError) as error:
                why = str(error).splitlines()[0] if str(error) else type(error).__name__
                remedy = "start `dask scheduler` and, on each host, `dask worker ADDRESS --nthreads 1 --resources quiet=1`"
                raise UserError(f"--on {address}: {why}", remedy) from None
            others = {name for name, digest in client.run(source_digest).items() if digest != source_digest()}
            if others:
                raise UserError(f"--on {address}: {min(others)} runs another lfpipe", "install the same version on all hosts")
        else:
            local = LocalCluster(
                n_workers=jobs, threads_per_worker=1, processes=True, resources={QUIET: 1}, dashboard_address=None,
                worker_dashboard_address=None, silence_logs=50, host="127.0.0.1", memory_limit=0, protocol="tls://",
                security=Security.temporary(),
            )  # fmt: skip
            stack.enter_context(local)
            client = stack.enter_context(Client(local, set_as_default=False))
        yield client


class Sweep:
    """Sends cells to the cluster and takes their outcomes. work: measures a cell; always `measure_cell` except in tests."""

    def __init__(
        self, client: Client, done: Callable[[Outcome], None], order: Callable[[Cell], Order], notice: Callable[[str], None],
        work: Callable[[Cell, Order], Outcome] = measure_cell,
    ) -> None:  # fmt: skip
        self._client, self._done, self._order, self._notice, self._work = client, done, order, notice, work
        self._cells: dict[str, Cell] = {}  # by key: those that the scheduler has
        self._running: dict[str, tuple[float, float, str]] = {}  # by key: began, time of the next line, host
        client.subscribe_topic(TOPIC, self._hear)

    def run(self, every: Sequence[Cell]) -> None:
        """Shared cells first, then timed ones, then again those whose process died. Raises UserError if the cluster is gone."""
        try:
            suspects = self._measure([cell for cell in every if not cell.timed])
            if timed := [cell for cell in every if cell.timed]:
                if not (hosts := self._hosts(QUIET)):
                    why = f"no worker has the resource {QUIET}: start one per host with --resources {QUIET}=1"
                    for cell in timed:
                        self._done(Outcome(cell, FAILED, why))
                else:
                    suspects |= self._measure(timed, hosts)
            for cell, died in suspects.items():
                log.info("again, alone: %s: %s", cell.name, died.reason)
                for outcome in self._measure([cell]).values():
                    self._done(attrs.evolve(outcome, state=FAILED, reason=f"{outcome.reason}, also alone"))
        except (OSError, CancelledError):  # a connection lost in the middle of a call
            if self._reachable():
                raise
            raise self._gone() from None

    def _hosts(self, resource: str = "") -> dict[str, list[str]]:
        """Host -> addresses of its workers, of those with a resource."""
        hosts: dict[str, list[str]] = {}
        for address, worker in self._client.scheduler_info(n_workers=-1)["workers"].items():
            if not resource or resource in worker.get("resources", {}):
                hosts.setdefault(worker["host"], []).append(address)
        return hosts

    def _measure(self, every: Sequence[Cell], hosts: dict[str, list[str]] | None = None) -> dict[Cell, Outcome]:
        """Measures cells; returns those whose process died. hosts: one cell at a time on each of them."""
        waiting, free, tries = list(reversed(every)), list(hosts or ()), Counter[str]()
        suspects: dict[Cell, Outcome] = {}
        places: dict[str, str] = {}
        answers = as_completed(loop=self._client.loop)
        while waiting or not answers.is_empty():
            while waiting and (free or not hosts):
                cell = waiting.pop()
                place = places[cell.key] = free.pop() if hosts else ""
                self._cells[cell.key] = cell
                future = self._client.submit(
                    self._work, cell, self._order(cell), key=f"{cell.key}/{time.monotonic_ns()}", pure=False,
                    resources={QUIET: 1} if cell.timed else None, workers=hosts[place] if hosts else None,
                    allow_other_workers=bool(hosts),
                )  # fmt: skip
                answers.add(future)
            future = self._next(answers)
            cell = self._cells.pop(str(future.key).partition("/")[0])
            self._running.pop(cell.key, None)
            if hosts:
                free.append(places[cell.key])
            outcome = self._outcome(cell, future)
            if outcome is None and tries[cell.key] < TRIES:
                tries[cell.key] += 1
                waiting.append(cell)
            elif outcome is None:
                self._done(Outcome(cell, FAILED, "its result was lost with its worker, several times"))
            elif outcome.state == DIED:
                suspects[cell] = outcome
            else:
                self._done(outcome)
        return suspects

    def _outcome(self, cell: Cell, future: Future) -> Outcome | None:
        """The outcome of a future that has ended; None if lost with its worker. Raises UserError if the cluster is gone."""
        try:
            outcome: Outcome = future.result()
            return outcome
        except KilledWorker:
            return Outcome(cell, DIED, f"its worker died {TRIES + 1} times: out of memory, or a crash")
        except CancelledError:  # the worker died while the result travelled
            if self._client.status != "running" or not self._reachable():
                raise self._gone() from None
            return None
        except OSError:
            if self._reachable():
                return None
            raise
        except Exception as error:
            return Outcome(cell, FAILED, f"{type(error).__name__}: {error}")

    def _next(self, answers: as_completed) -> Future:
        """Waits for an answer and names cells that take long. Raises UserError if no answer can come."""
        began = time.monotonic()
        while not answers.has_ready():
            time.sleep(0.02)
            now = time.monotonic()
            if self._client.status not in ("running", "connecting"):
                raise self._gone()
            if now - began > WORKER_WAIT_S and self._client.status == "running" and not self._hosts():
                raise UserError("all workers are gone; finished cells are kept", AGAIN)
            began = now if now - began > WORKER_WAIT_S else began
            for key, (start, line_s, host) in list(self._running.items()):
                if now - start > line_s and key in self._cells:
                    self._notice(f"running for {now - start:.0f} s on {host}: {self._cells[key].name}")
                    self._running[key] = start, 2 * line_s, host
        return next(answers)

    def _hear(self, event: tuple[float, dict[str, str]]) -> None:
        """A worker's message: that a cell begins (no text), or whom it waits for."""
        message = event[1]
        if cell := self._cells.get(message["key"]):
            if message["text"]:
                self._notice(f"{cell.name} on {message['host']} {message['text']}")
            else:
                self._running[cell.key] = time.monotonic(), FIRST_LINE_S, message["host"]

    def _reachable(self) -> bool:
        try:
            self._client.sync(self._client.scheduler.identity, n_workers=0)
        except Exception:  # every kind of lost connection
            return False
        return True

    def _gone(self) -> UserError:
        return UserError("the scheduler is gone; finished cells are kept", AGAIN)


def sweep(plan: Plan, out: Path, options: Options) -> list[Outcome]:
    """Measures the cells that are not yet in out; returns the outcomes of all cells, in the order of the plan.

    Raises UserError if out cannot be written, or the cluster is gone. Finished cells are kept.
    """
    if options.expect is not None and options.update:
        options.expect.mkdir(parents=True, exist_ok=True)
    version = f"{source_digest()} {sorted((name, each) for name, each in versions().items() if name != 'processor')}"
    every = [marked(cell, options.expect, options.update) for cell in cells(plan, version)]
    store = Store(out)
    todo: dict[str, Cell] = {}  # scenes of equal name and content are one cell
    for cell in every:
        known = store.outcomes.get(cell.key)
        if cell.why_not:
            if known is None or known.reason != cell.why_not:
                store.append(Outcome(cell, FAILED, cell.why_not))
        elif known is None or known.state not in DONE:
            todo[cell.key] = cell
    left = len(todo)

    def take(outcome: Outcome) -> None:
        nonlocal left
        left -= 1
        store.append(judged(outcome, options.expect, options.update))
        options.progress("cells", len(every) - left, len(every))

    def order(cell: Cell) -> Order:
        place = place_of(cell, options.expect)
        use = cell.subject == REPLAY and place is not None and (options.update or is_dir(place))
        return Order(options.limit_s, str(place.resolve()) if use and place else "", options.update)

    options.progress("cells", len(every) - left, len(every))
    try:
        if todo:
            with cluster(options.address, options.jobs, options.insecure) as client:
                Sweep(client, take, order, options.notice).run(list(todo.values()))
    finally:
        store.close()
    return [store.outcomes[cell.key] for cell in every]
