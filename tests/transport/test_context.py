"""`Context.wait`: the events that wake a stage."""

import secrets
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zmq

from lfpipe.config import Config, SessionOptions
from lfpipe.config.session_options import Live, Lossless
from lfpipe.errors import UserError
from lfpipe.host.files import Wake
from lfpipe.supervisor.process_table import SOURCE, consumers
from lfpipe.supervisor.session_state import SessionState, SessionStore
from lfpipe.transport import control
from lfpipe.transport.context import Context, RingOutput, StageSpec
from lfpipe.transport.control import Session
from lfpipe.transport.ring import now_ns
from lfpipe.transport.status import State
from tests.support.world import until


def opened(folder: Path, patch: pytest.MonkeyPatch) -> tuple[Session, SessionStore]:
    """A session with this runtime directory, and its memory."""
    patch.setenv("LFPIPE_RUN_DIR", str(folder))
    made = Session(f"c{secrets.token_hex(4)}")
    made.run_dir.mkdir(mode=0o700)
    return made, SessionStore(made, SessionState.first(Config(), SessionOptions()))


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    made, memory = opened(tmp_path, monkeypatch)
    yield made
    memory.close()


def test_session_store_closed_does_not_hide_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, memory = opened(tmp_path, monkeypatch)
    with pytest.raises(ZeroDivisionError):
        try:
            row = memory.table.rows["render"]  # referenced by the stack of the error
            row["pid"] = 1 // 0
        finally:
            memory.close()
    assert not [path for path in made.run_dir.iterdir() if path.is_file()]


# mappings go with the process
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

Make = Callable[[str, bool], Context]


@pytest.fixture
def make(session: Session) -> Iterator[Make]:
    """Makes the context of a stage; the second parameter: lossless."""
    made = []

    def context(name: str, lossless: bool) -> Context:
        spec = StageSpec(
            name=name,
            module="",
            session=session,
            config=Config(),
            rev=1,
            options=SessionOptions(clock=Lossless() if lossless else Live()),
            consumers=consumers(),
            others=(),
            source=SOURCE,
        )
        made.append(Context(spec))
        return made[-1]

    yield context
    for each in made:
        each.close()


def wakes(context: Context, seconds: float) -> int:
    """How often a stage that has nothing to do until then is woken. It beats every 100 ms."""
    count = 0
    end_ns = now_ns() + int(seconds * 1e9)
    while now_ns() < end_ns:
        context.wait(end_ns)
        count += 1
    return count


def test_context_wait_is_not_ended_by_a_credit(session: Session, make: Make) -> None:
    """At pace=max, where a reader reports every slot to the writer, which looks at it only when it
    wants to publish again.
    """
    context = make("track", True)
    eyes = context.output("eyes")
    for reader in ("render", "share"):
        credit = Wake(session.credit("eyes", reader))
        credit.notify(1)
        credit.close()
    assert wakes(context, 0.35) <= 6
    context.table.rows["render"]["state"] = context.table.rows["share"]["state"] = State.RUNNING
    context.stopping = False
    eyes.begin()
    assert eyes.publish(0, 1, 1) == 1, "there is room"


def test_context_wait_ends_at_the_stop_and_passes_other_commands_on(
    session: Session, make: Make
) -> None:
    with control.context() as ctx, ctx.socket(zmq.ROUTER) as supervisor:
        supervisor.bind(f"ipc://{session.run_dir / 'ctl'}")
        context = make("render", False)
        name, hello = supervisor.recv_multipart()
        assert control.decode(hello)["cmd"] == "hello"
        for word in ("recentre", "stop"):
            supervisor.send_multipart([name, control.encode({"cmd": word})])
        until(lambda: not context.wait(), "stop", 30)
        assert [found for found, _ in context.commands()] == ["recentre"]
        context.answer({"number": 3}, UserError("no such file", "check its name"))
        answer = control.decode(supervisor.recv_multipart()[1])
        assert (answer["number"], answer["ok"], answer["error"]) == (3, False, "no such file")


def test_context_wait_leaves_a_wake_for_the_stage(session: Session, make: Make) -> None:
    context = make("track", False)
    frames = context.input("frames")
    Wake(session.wake("frames", "track")).notify(1)
    begin_ns = now_ns()
    context.wait(begin_ns + 10**9)
    assert frames.wake.drain() == 1
    assert wakes(context, 0.35) <= 6


def test_a_slot_wakes_the_readers_that_run(session: Session, make: Make) -> None:
    context = make("track", False)
    eyes = context.output("eyes")
    context.table.rows["render"]["state"] = State.STARTING
    context.table.rows["share"]["state"] = State.DEAD
    eyes.begin()
    eyes.publish(0, 1, 1)
    woken = {reader: Wake(session.wake("eyes", reader)).drain() for reader in consumers()["eyes"]}
    assert {reader for reader, slots in woken.items() if slots} == {"render"}
    assert "share" in woken


def test_a_lossless_writer_is_a_few_slots_ahead_of_who_still_reads(
    session: Session, make: Make
) -> None:
    context = make("track", True)
    asked: list[bool] = []
    eyes = RingOutput(
        context.spec, "eyes", context.table, lambda ready, _: asked.append(ready()), lambda: None
    )
    at = context.spec.ring_index("eyes")
    slow, quick = (context.table.rows[name] for name in ("render", "share"))
    for published in range(12):
        for taken in range(published + 1):
            slow["taken_seq"][at], quick["taken_seq"][at] = taken, published
            slow["state"] = quick["state"] = State.RUNNING
            assert eyes._all_read() is (published - taken <= eyes.writer.slots - 4)
            slow["state"] = State.DEAD
            assert eyes._all_read(), "nobody waits for the dead"
        eyes.begin()
        eyes.publish(published, 1, 1)
    assert asked == [True] * 12


def test_a_successor_counts_what_its_predecessor_left(make: Make) -> None:
    eyes = make("track", False).output("eyes")
    render = make("render", False)
    dies = render.input("eyes")
    for number in range(6):
        eyes.begin()
        eyes.publish(number, 1, 1)
        if number == 2:
            dies.peek()
            dies.done()
    render.input("eyes").peek()
    assert render.row["drops"] == 2 + 2


def test_a_stage_that_sets_up_again_has_the_limits_of_its_start(make: Make) -> None:
    context = make("render", False)
    context.row["state"] = State.RUNNING
    with pytest.raises(OSError), context.setting_up("opening the scene"):
        assert context.row["state"] == State.STARTING
        raise OSError
    assert context.row["state"] == State.RUNNING


def test_report_lost_counts_a_lost_output(make: Make) -> None:
    context = make("render", False)
    context.report_lost("no space left")
    assert context.row["lost_outputs"] == 1


def test_an_output_that_ends_leaves_no_descriptor(session: Session, make: Make) -> None:
    context = make("render", False)
    counts = []
    for _ in range(5):
        output = context.output("eyes")
        output.begin()
        output.publish(1, 1, 1)
        output.close()
        counts.append(len(list(Path("/dev/fd").iterdir())))
    assert counts[-1] <= counts[0]
