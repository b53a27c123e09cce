"""Runs the cells of a sweep: in threads of this process, or on Dask distributed by the address of a
scheduler.

Every cell is a process of its own. Timed cells run one at a time, after all
others, and so does, once more, a cell whose process or worker died.
"""

import contextlib
import hashlib
import itertools
import json
import logging
import queue
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import cache, partial
from pathlib import Path
from typing import Any

import attrs
import psutil

from lfpipe.errors import UserError
from lfpipe.extras.sweep.plan import TIMED, Cell
from lfpipe.extras.sweep.results import DIED, FAILED, Outcome, Store
from lfpipe.extras.sweep.work import SweepOptions, measure_cell
from lfpipe.host.files import is_dir, is_file
from lfpipe.host.worker import install_command, versions
from lfpipe.sequence.folder import MANIFEST, is_sequence

AGAIN = "start it again, then run the same command"
# a host that does not answer; workers that have just been started
SCHEDULER_WAIT_S = 8.0
FIRST_LINE_S = 30.0  # without a result, what runs is named; again after twice that time, and so on
Notice = Callable[[str], None]


@attrs.frozen
class Workers:
    """What measures cells."""

    submit: Callable[[Cell, SweepOptions], Any]
    """Starts measuring a cell and returns its future, of Dask or of Python."""
    count: Callable[[], int]
    """Raises UserError if there are none."""


@cache
def content(path: str) -> str:
    """Hash of a file, or of the files in a folder; of a recording, of its manifest, which holds
    checksums.
    """
    place = Path(path)
    if is_sequence(place):
        files = [place / MANIFEST]
    else:
        files = sorted(place.rglob("*")) if is_dir(place) else [place]
    digest = hashlib.blake2b(digest_size=12)
    for file in filter(is_file, files):
        digest.update(str(file.relative_to(place)).encode(errors="surrogateescape"))
        # the cell names what cannot be read
        with contextlib.suppress(OSError), file.open("rb") as stream:
            digest.update(hashlib.file_digest(stream, "blake2b").digest())
    return digest.hexdigest()


def source_digest() -> str:
    """Hash of the package's own files: a changed program measures again."""
    return _hash(*(content(str(path)) for path in sorted(Path(__file__).parents[2].rglob("*.py"))))


def _hash(*texts: str) -> str:
    return hashlib.blake2b(json.dumps(texts).encode(), digest_size=12).hexdigest()


def keyed(cell: Cell, version: str, options: SweepOptions) -> Cell:
    """The cell with its key: of the program, the cell, its inputs, and its reference, or, with
    update, whether there is one.
    """
    place = options.reference(cell)
    reference = ""
    if place is not None:
        reference = f"update {is_dir(place)}" if options.update else content(str(place))
    inputs = (content(path) if path else "" for path in (cell.sequence, cell.scene))
    return attrs.evolve(cell, key=_hash(version, cell.name, *inputs, reference))


@contextlib.contextmanager
def local_workers(
    jobs: int, work: Callable[[Cell, SweepOptions], Outcome] = measure_cell
) -> Iterator[Workers]:
    """Threads of this process. Cells that still run at the end are killed."""
    with ThreadPoolExecutor(jobs) as pool:
        try:
            yield Workers(lambda cell, options: pool.submit(work, cell, options), lambda: jobs)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in psutil.Process().children():
                child.kill()


@contextlib.contextmanager
def dask_workers(address: str, insecure: bool = False) -> Iterator[Workers]:
    """The workers of the scheduler at address.

    Dask runs whatever code it receives, so the scheduler needs certificates, those of Dask's
    configuration; insecure: connect without. Raises UserError.
    """
    if not address.startswith("tls://") and not insecure:
        what = (
            f"--on {address}: without TLS, anyone who can reach this port runs code as you: Dask"
            " unpickles what it receives"
        )
        raise UserError(
            what,
            "start Dask with certificates and name tls://HOST:PORT; on a network of your own, add"
            " --insecure",
        )
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise UserError(
            f"--on needs the package {error.name}", install_command("dask", "distributed")
        ) from None
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # we report errors ourselves
    with (
        dask.config.set({"distributed.comm.timeouts.connect": f"{SCHEDULER_WAIT_S:g}s"}),
        contextlib.ExitStack() as stack,
    ):
        try:
            client = stack.enter_context(
                Client(address, timeout=SCHEDULER_WAIT_S, set_as_default=False)
            )
            client.wait_for_workers(1, timeout=30.0)
        except (OSError, ValueError, TypeError, TimeoutError) as error:
            why = str(error).splitlines()[0] if str(error) else type(error).__name__
            remedy = "start `dask scheduler` and, on each host, `dask worker ADDRESS --nthreads 1`"
            raise UserError(f"--on {address}: {why}", remedy) from None
        if others := {
            name for name, digest in client.run(source_digest).items() if digest != source_digest()
        }:
            raise UserError(
                f"--on {address}: {min(others)} runs another lfpipe",
                "install the same version on all hosts",
            )

        def count() -> int:
            try:
                workers = len(client.processing())
            except Exception:  # every kind of lost connection
                raise UserError("the scheduler is gone; finished cells are kept", AGAIN) from None
            if not workers:
                raise UserError("all workers are gone; finished cells are kept", AGAIN)
            return workers

        yield Workers(partial(client.submit, measure_cell, pure=False), count)


def outcomes(
    workers: Workers, cells: Sequence[Cell], options: SweepOptions, notice: Notice
) -> Iterator[Outcome]:
    """The outcomes of cells as they come, DIED for one whose process or worker died. While none
    comes, the oldest are named.

    Raises UserError if no answer can come.
    """
    done: queue.SimpleQueue[Any] = queue.SimpleQueue()
    running = {workers.submit(cell, options): cell for cell in cells}
    for future in running:
        future.add_done_callback(done.put)
    waited_s = 0.0
    while running:
        try:
            future = done.get(timeout=waited_s or FIRST_LINE_S)
        except queue.Empty:
            waited_s = 2 * waited_s or FIRST_LINE_S
            names = ", ".join(
                cell.name for cell in itertools.islice(running.values(), workers.count())
            )
            notice(f"no result for {waited_s:.0f} s; running: {names}")
            continue
        waited_s = 0.0
        cell = running.pop(future)
        try:
            yield future.result()
        except (OSError, CancelledError) as error:  # the worker died while the result travelled
            workers.count()
            yield Outcome(cell, DIED, f"its worker died: {type(error).__name__}")
        except Exception as error:
            # Dask's word for a cell whose workers died several times
            died = type(error).__name__ == "KilledWorker"
            yield Outcome(cell, DIED if died else FAILED, f"{type(error).__name__}: {error}")


def run_cells(
    workers: Workers,
    cells: Sequence[Cell],
    options: SweepOptions,
    take: Callable[[Outcome], None],
    notice: Notice,
) -> None:
    """Measures cells: those that may run beside others, then the rest, each alone. take: receives
    the outcomes.
    """
    alone = [cell for cell in cells if cell.subject in TIMED]
    for outcome in outcomes(
        workers, [cell for cell in cells if cell.subject not in TIMED], options, notice
    ):
        alone.append(outcome.cell) if outcome.state == DIED else take(outcome)
    for cell in alone:
        (outcome,) = outcomes(workers, [cell], options, notice)
        died = outcome.state == DIED
        take(
            attrs.evolve(outcome, state=FAILED, reason=f"{outcome.reason}, also alone")
            if died
            else outcome
        )


def run_sweep(
    plan: Sequence[Cell],
    out: Path,
    place: AbstractContextManager[Workers],
    options: SweepOptions,
    progress: Callable[[str, int, int], None],
    notice: Notice,
) -> list[Outcome]:
    """Measures the cells that are not yet in out; returns the outcomes of all cells, in the order
    of the plan.

    place: gives the workers, if any are needed. progress: (what, done, total). notice: receives
    lines for the user. Raises UserError if out cannot be written, or the workers are gone. Finished
    cells are kept.
    """
    version = f"{source_digest()} {versions() | {'processor': ''}}"
    every = [keyed(cell, version, options) for cell in plan]
    store = Store(out)
    # scenes of equal name and content are one cell
    todo = {cell.key: cell for cell in every if cell.key not in store.outcomes}

    def take(outcome: Outcome) -> None:
        store.append(outcome)
        todo.pop(outcome.cell.key)
        progress("cells", len(every) - len(todo), len(every))

    progress("cells", len(every) - len(todo), len(every))
    try:
        if todo:
            with place as workers:
                run_cells(workers, list(todo.values()), options, take, notice)
    finally:
        store.close()
    return [store.outcomes[cell.key] for cell in every]
