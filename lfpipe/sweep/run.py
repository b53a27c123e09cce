"""Runs a sweep on Dask distributed: on a local cluster, or on any scheduler by its address.

Dask starts a cell again whose worker has died, and gives timed cells to workers with the resource `quiet`: one on each host. They
run after all others. A cell whose process died runs again, alone, at the end.
"""

import contextlib
import hashlib
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from pathlib import Path

import attrs
import dask
from distributed import Client, Future, Nanny, Scheduler, Security, SpecCluster, as_completed
from distributed.scheduler import KilledWorker

import lfpipe
from lfpipe.errors import UserError
from lfpipe.host.files import is_dir
from lfpipe.host.machine import versions
from lfpipe.sweep.plan import REPLAY, Cell, Plan, cells
from lfpipe.sweep.results import DIED, DONE, FAILED, Outcome, References, Store
from lfpipe.sweep.work import Order, measure_cell

QUIET = "quiet"
TRIES = 3  # deaths of workers that a cell survives
AGAIN = "start it again, then run the same command"
SCHEDULER_WAIT_S, WORKER_WAIT_S = 8.0, 30.0
FIRST_LINE_S = 30.0  # without a result, what runs is named; again after twice that time, and so on
SETTINGS = {
    "distributed.scheduler.allowed-failures": TRIES,
    "distributed.worker.daemon": False,  # replays start processes of their own
    "distributed.comm.timeouts.connect": f"{SCHEDULER_WAIT_S:g}s",
    "distributed.scheduler.worker-ttl": "5 minutes",
}


@attrs.frozen
class Options:
    """address: of a scheduler, "" for a local cluster of `jobs` workers. limit_s: of a cell. references: None without --expect.
    progress: (what, done, total). notice: receives lines for the user."""

    address: str
    jobs: int
    limit_s: float
    references: References | None
    insecure: bool
    progress: Callable[[str, int, int], None]
    notice: Callable[[str], None]


def source_digest() -> str:
    """Hash of the package's own files: a changed program measures again."""
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(lfpipe.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


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
        if not address:
            security = Security.temporary()
            common = {"protocol": "tls://", "security": security, "host": "127.0.0.1", "dashboard": False}
            worker = {**common, "nthreads": 1, "memory_limit": 0, "silence_logs": 50}
            workers = {k: {"cls": Nanny, "options": worker | {"resources": {} if k else {QUIET: 1}}} for k in range(jobs)}
            scheduler = {"cls": Scheduler, "options": {**common, "port": 0}}
            local = stack.enter_context(SpecCluster(workers, scheduler, security=security, silence_logs=50))
            yield stack.enter_context(Client(local, set_as_default=False))
            return
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
        yield client


class Sweep:
    """Sends cells to the cluster and takes their outcomes. work: measures a cell; always `measure_cell` except in tests."""

    def __init__(
        self, client: Client, done: Callable[[Outcome], None], order: Callable[[Cell], Order], notice: Callable[[str], None],
        work: Callable[[Cell, Order], Outcome] = measure_cell,
    ) -> None:  # fmt: skip
        self._client, self._done, self._order, self._notice, self._work = client, done, order, notice, work
        self._cells: dict[str, Cell] = {}  # by key: those that the scheduler has

    def run(self, every: Sequence[Cell]) -> None:
        """Shared cells first, then timed ones, then again those whose process died. Raises UserError if the cluster is gone."""
        shared, timed = ([cell for cell in every if cell.timed == kind] for kind in (False, True))
        try:
            if timed and not any(QUIET in worker.get("resources", {}) for worker in self._workers()):
                why = f"no worker has the resource {QUIET}: start one per host with --resources {QUIET}=1"
                for cell in timed:
                    self._done(Outcome(cell, FAILED, why))
                timed = []
            suspects = [*self._measure(shared), *self._measure(timed)]
            for suspect in suspects:
                for outcome in self._measure([suspect.cell]):
                    self._done(attrs.evolve(outcome, state=FAILED, reason=f"{outcome.reason}, also alone"))
        except (OSError, CancelledError):  # a connection lost in the middle of a call
            if self._reachable():
                raise
            raise self._gone() from None

    def _workers(self) -> Sequence[dict[str, dict[str, float]]]:
        return list(self._client.scheduler_info(n_workers=-1)["workers"].values())

    def _submit(self, cell: Cell) -> Future:
        self._cells[cell.key] = cell
        resources = {QUIET: 1} if cell.timed else None
        key = f"{cell.key}/{time.monotonic_ns()}"
        return self._client.submit(self._work, cell, self._order(cell), key=key, pure=False, resources=resources)

    def _measure(self, every: Sequence[Cell]) -> list[Outcome]:
        """Measures cells; returns the outcomes of those whose process died."""
        died, tries = [], Counter[str]()
        answers = as_completed([self._submit(cell) for cell in every], loop=self._client.loop)
        while not answers.is_empty():
            future = self._next(answers)
            cell = self._cells.pop(str(future.key).partition("/")[0])
            try:
                outcome: Outcome = future.result()
            except KilledWorker:
                outcome = Outcome(cell, DIED, f"its worker died {TRIES + 1} times: out of memory, or a crash")
            except (OSError, CancelledError):  # the worker died while the result travelled
                if not self._reachable():
                    raise self._gone() from None
                tries[cell.key] += 1
                if tries[cell.key] <= TRIES:
                    answers.add(self._submit(cell))
                    continue
                outcome = Outcome(cell, FAILED, "its result was lost with its worker, several times")
            except Exception as error:
                outcome = Outcome(cell, FAILED, f"{type(error).__name__}: {error}")
            died += [outcome] if outcome.state == DIED else []
            if outcome.state != DIED:
                self._done(outcome)
        return died

    def _next(self, answers: as_completed) -> Future:
        """Waits for an answer and names the cells that run meanwhile. Raises UserError if no answer can come."""
        began, line_s = time.monotonic(), FIRST_LINE_S
        while not answers.has_ready():
            time.sleep(0.02)
            waited_s = time.monotonic() - began
            if self._client.status not in ("running", "connecting"):
                raise self._gone()
            if waited_s > line_s and self._client.status == "running":
                if waited_s > WORKER_WAIT_S and not self._workers():
                    raise UserError("all workers are gone; finished cells are kept", AGAIN)
                oldest = [str(keys[0]).partition("/")[0] for keys in self._client.processing().values() if keys]
                names = ", ".join(self._cells[key].name for key in oldest if key in self._cells)
                self._notice(f"no result for {waited_s:.0f} s; running: {names}")
                line_s *= 2
        return next(answers)

    def _reachable(self) -> bool:
        try:
            self._client.sync(self._client.scheduler.identity, n_workers=0)
        except Exception:  # every kind of lost connection
            return False
        return str(self._client.status) == "running"

    def _gone(self) -> UserError:
        return UserError("the scheduler is gone; finished cells are kept", AGAIN)


def sweep(plan: Plan, out: Path, options: Options) -> list[Outcome]:
    """Measures the cells that are not yet in out; returns the outcomes of all cells, in the order of the plan.

    Raises UserError if out cannot be written, or the cluster is gone. Finished cells are kept.
    """
    version = f"{source_digest()} {sorted((name, text) for name, text in versions().items() if name != 'processor')}"
    references = options.references
    every = [references.marked(cell) if references else cell for cell in cells(plan, version)]
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
        store.append(references.judged(outcome) if references else outcome)
        options.progress("cells", len(every) - left, len(every))

    def order(cell: Cell) -> Order:
        place = references.place(cell) if references and cell.subject == REPLAY else None
        if references is None or place is None or not (references.update or is_dir(place)):
            return Order(options.limit_s)
        return Order(options.limit_s, str(place.resolve()), references.update)

    options.progress("cells", len(every) - left, len(every))
    try:
        if references and references.update:
            references.folder.mkdir(parents=True, exist_ok=True)
        if todo:
            with cluster(options.address, options.jobs, options.insecure) as client:
                Sweep(client, take, order, options.notice).run(list(todo.values()))
    finally:
        store.close()
    return [store.outcomes[cell.key] for cell in every]
