"""What a session waits for without blocking, whatever bytes arrive: requests on ctl, not
interpreted here, and telemetry from bus to tap; answers that wait until the stages have applied
a revision of the state, or have executed a command; and its packers, one for the disparity of the
scene on screen, one for a requested scene.
"""

import contextlib
import itertools
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs
import zmq

from lfpipe.config import SceneSummary
from lfpipe.scene.pack import PackerRequest, Packing
from lfpipe.supervisor.requests import Reply, Then
from lfpipe.transport import control
from lfpipe.transport.control import BadMessage, Message
from lfpipe.transport.ring import SECOND_NS, now_ns

MOST = 32  # messages of a socket per step of the session, which has other work
WAITING = 64  # messages of a client that wait here; more wait in the client
HANDSHAKE_MS = 2000  # a connection that has not said what it is by then is closed
LINGER_MS = 200  # for the last answers, at the end


@attrs.define
class Request:
    """A message of a client, not checked before `decode`."""

    client: bytes
    """The identity of its socket; a stage's is the stage's name."""
    parts: list[bytes] = attrs.field(factory=list)
    message: Message = attrs.field(factory=dict)
    """Its readable fields."""

    @property
    def command(self) -> str:
        """The command, "" without one."""
        return str(self.message.get("cmd", ""))

    @property
    def sender(self) -> str:
        """The identity as text: the name of a stage, or a text that is no stage's name."""
        return self.client.decode(errors="replace")

    def decode(self) -> None:
        """Reads the message. Raises BadMessage; the answer then repeats the readable fields."""
        if len(self.parts) != 1:
            raise BadMessage(f"a message has {len(self.parts)} parts; one is allowed")
        self.message = control.unpack(self.parts[0])
        control.check(self.message)


class ControlSockets:
    """ctl, bus and tap in a run directory. Raises OSError if a socket cannot be made."""

    def __init__(self, run_dir: Path) -> None:
        with contextlib.ExitStack() as parts:
            context = parts.enter_context(control.context())
            context.linger = LINGER_MS

            def bound(kind: int, name: str, max_bytes: int) -> zmq.Socket[bytes]:
                """A socket to which only this user may connect. max_bytes: of a message; the
                client of a longer one is disconnected.
                """
                hidden = run_dir / f".{name}"  # ZeroMQ removes it, and not what is there later
                try:
                    socket = parts.enter_context(context.socket(kind))
                    socket.setsockopt(zmq.MAXMSGSIZE, max_bytes)
                    socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
                    socket.setsockopt(zmq.RCVHWM, WAITING)
                    if kind == zmq.ROUTER:  # a restarted stage has its old name
                        socket.setsockopt(zmq.ROUTER_HANDOVER, 1)
                    socket.bind(f"ipc://{hidden}")
                except zmq.ZMQError as error:
                    code = error.errno or 0
                    raise OSError(code, os.strerror(code), str(run_dir / name)) from None
                hidden.chmod(0o600)
                hidden.rename(run_dir / name)
                return socket

            # a message of more than MAX_BYTES gets an error answer, one of twice that size none
            self._ctl = bound(zmq.ROUTER, "ctl", 2 * control.MAX_BYTES)
            self._bus = bound(zmq.PULL, "bus", control.MAX_BYTES)
            self._tap = bound(zmq.PUB, "tap", control.MAX_BYTES)
            self.fds = [self._ctl, self._bus]  # that wake the supervisor
            self.close = parts.pop_all().close

    def messages(self) -> Iterator[Request | Message]:
        """Yields the requests and the valid telemetry that have arrived, at most MOST of each, and
        passes the telemetry on to tap.
        """
        for client, *parts in _receive(self._ctl):
            yield Request(client, parts)
        for data, *others in _receive(self._bus):
            with contextlib.suppress(BadMessage):
                message = control.decode(data)
                if not others:
                    self._tap.send(data)
                    yield message

    def answer(self, request: Request, rev: int, answer: Message) -> None:
        """Answers a request; the answer repeats its `id` and `cmd`. rev: of the state."""
        repeated = {"rev": rev, **control.repeated(request.message)}
        try:
            data = control.encode({**answer, **repeated})
        except BadMessage as error:
            why = f"the answer cannot be sent: {error}"
            data = control.encode({"ok": False, "error": why, **repeated})
        self.send_encoded(request.client, data)

    def send(self, stage: str, message: Message) -> None:
        """Sends a message to a stage. It is lost if the stage is not connected; the stage will send
        hello later.
        """
        self.send_encoded(stage.encode(), control.encode(message))

    def publish(self, topic: str, **values: Any) -> None:
        """Sends a message to every subscriber of the tap."""
        self._tap.send(control.encode({"topic": topic, "t_ns": now_ns(), **values}))

    def send_encoded(self, client: bytes, data: bytes) -> None:
        """Sends a message, which is lost if the client has gone or does not read."""
        self._ctl.send_multipart([client, data])


def _receive(socket: zmq.Socket[bytes]) -> Iterator[list[bytes]]:
    """The parts of each message that has arrived, of at most MOST."""
    with contextlib.suppress(zmq.Again):
        for _ in range(MOST):
            yield socket.recv_multipart(zmq.NOBLOCK)


APPLY_NS = SECOND_NS  # time limit for the stages to apply a change before the answer
OF_THE_MESSAGE = ("v", "cmd", "number", "id")  # not of the answer
# time limit for the stages to execute a command, or to finish their work after the source's end
EXECUTE_NS = 2 * SECOND_NS
START_NS = 12 * SECOND_NS  # likewise for a stage that starts for it: a disk or camera may be slow


@attrs.define(kw_only=True)
class _Pending:
    """A request that waits for the stages."""

    request: Request
    answer: Message
    """Its answer so far."""
    until_ns: int
    """The latest time of the answer."""
    rev: int
    """The revision that the stages apply; 0 if they execute a command."""
    on_trial: bool
    """Whether a rollback undoes the request."""
    missing: set[str]
    """The stages that have not executed it."""
    starts: bool
    """Whether they start for it."""
    then: Then | None
    """Makes the reply once they have."""


class PendingAnswers:
    """Requests that are answered later. It uses no socket and no clock."""

    def __init__(self) -> None:
        self._pending: dict[int, _Pending] = {}  # by the number that stages answer with
        self._numbers = itertools.count(1)

    def __bool__(self) -> bool:
        return bool(self._pending)

    def add(
        self, request: Request, reply: Reply, answer: Message, rev: int, on_trial: bool, t_ns: int
    ) -> int:
        """The answer waits until the stages have applied revision rev, or those of the reply have
        executed the command that is sent with the returned number. on_trial: whether a rollback
        undoes the request. t_ns: now.
        """
        number = next(self._numbers)
        starts = bool(reply.executed_by) and reply.state is not None
        limit_ns = START_NS if starts else EXECUTE_NS if reply.executed_by else APPLY_NS
        self._pending[number] = _Pending(
            request=request,
            answer=answer,
            until_ns=t_ns + limit_ns,
            rev=0 if reply.executed_by else rev,
            on_trial=on_trial,
            missing=set(reply.executed_by),
            starts=starts,
            then=reply.then,
        )
        return number

    def number_for(self, stage: str) -> int:
        """The number of the newest request that the stage answers once it works; 0 for none."""
        numbers = [
            number
            for number, pending in self._pending.items()
            if pending.starts and stage in pending.missing
        ]
        return max(numbers, default=0)

    def executed(self, stage: str, message: Message) -> None:
        """Processes a stage's answer: `number`, `ok`, and further values, which the client receives
        under `stages` and the stage's name, together with the first refusal.
        """
        number = message.get("number")
        pending = self._pending.get(number) if isinstance(number, int) else None
        if pending is None or stage not in pending.missing:
            return
        pending.missing.discard(stage)
        result = {key: value for key, value in message.items() if key not in OF_THE_MESSAGE}
        if result.pop("ok", None) is not True:
            pending.answer = {"ok": False, **result} if pending.answer["ok"] else pending.answer
        elif result and pending.answer["ok"]:
            stages = {**pending.answer.get("stages", {}), stage: result}
            pending.answer = {**pending.answer, "stages": stages}

    def refuse_changes(self, why: Message) -> Iterator[tuple[Request, Message]]:
        """The answers to all requests that wait for a change that was rolled back; the others
        were not undone, and wait for the stages.
        """
        for number, pending in list(self._pending.items()):
            if pending.on_trial:
                del self._pending[number]
                yield pending.request, {"ok": False, **why}

    def due(
        self, applied: Callable[[int], bool], t_ns: int
    ) -> Iterator[tuple[Request, Message, Then | None]]:
        """The answers that wait no longer, or what makes the reply from them. applied: whether the
        stages have applied a revision.
        """
        for number, pending in list(self._pending.items()):
            done = applied(pending.rev) if pending.rev else not pending.missing
            if not done and t_ns <= pending.until_ns:
                continue
            del self._pending[number]
            answer = pending.answer
            if pending.rev:
                answer = {**answer, "applied": done}
            elif not done:
                stages = " and ".join(sorted(pending.missing))
                limit_s = (START_NS if pending.starts else EXECUTE_NS) // SECOND_NS
                why = f"{stages} did not execute it within {limit_s} s"
                answer = {
                    "ok": False,
                    "error": why,
                    "remedy": "check the session: `lfpipe monitor`",
                }
            yield pending.request, answer, pending.then if answer["ok"] else None


STEP_NS = SECOND_NS // 5  # between two reports of progress
WANTED, SHOWN = "wanted", "shown"  # scenes: of a request, and on the screen
Send = Callable[[Message], None]  # to the stage that shows pictures


@attrs.define(eq=False)
class Load:
    """A running packer, and its last reported progress."""

    packing: Packing
    request: Request | None = None
    """For the scene; None for the scene on the screen."""
    reported: str = ""
    """The step of the packer."""
    report_ns: int = 0
    """When it was reported."""

    def outcome(self) -> SceneSummary | Exception | None:
        """The scene once it is ready to be shown, or the error."""
        packing = self.packing
        scene: SceneSummary | Exception | None = packing.views if self.request else None
        if packing.done:
            try:
                scene = packing.summary()
            except Exception as error:  # the client's answer
                scene = error
                for path in packing.scenes[:1]:  # the packer may have crashed
                    packing.unusable.setdefault(path, str(error).partition("\n")[0])
        return scene


class SceneLoads:
    """The packers of both scenes. send: for their progress, a few times a second."""

    def __init__(self, send: Send, packing: Packing | None = None) -> None:
        """packing: the packer of the session's first scene, while it works."""
        self._send = send
        self._loads = {} if packing is None else {SHOWN: Load(packing)}

    def want(self, request: Request, scene: PackerRequest) -> Request | None:
        """Starts to load a scene; returns the request that it replaces, if any. Raises UserError if
        no packer can be started; the one that runs then goes on.
        """
        load = Load(Packing(scene), request)
        replaced = self._loads.get(WANTED)
        self._end(WANTED)
        self._loads[WANTED] = load
        return None if replaced is None else replaced.request

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor."""
        return [fd for load in self._loads.values() for fd in load.packing.fds]

    def events(self) -> list[tuple[Load, SceneSummary | Exception]]:
        """Reads the packers' output; returns the loads with an outcome, and that."""
        events = []
        for name in (WANTED, SHOWN):
            if (load := self._loads.get(name)) is None:
                continue
            load.packing.read()
            self._report(load)
            scene = load.outcome()
            if scene is None:
                continue
            events.append((load, scene))
            if isinstance(scene, SceneSummary):
                self._end(SHOWN)
            if scene is load.packing.views:  # the packer continues with its disparity
                self._report(load, end=True)
                self._loads = {SHOWN: Load(load.packing)}
            else:
                self._end(name)
        return events

    def _report(self, load: Load, end: bool = False) -> None:
        """Sends the step of a packer if it is new; at the end, sends "" immediately."""
        step = "" if end else load.packing.step
        if step == load.reported or not (end or now_ns() >= load.report_ns + STEP_NS):
            return
        load.reported = step
        load.report_ns = now_ns()
        self._send(
            {
                "cmd": "loading",
                "scene": (load.packing.scenes or [load.packing.subject])[0],
                "step": step,
                "share": 1.0 if end else load.packing.share,
                "shown": load.request is None,
            }
        )

    def _end(self, name: str) -> None:
        """Ends a packer. If its pack is incomplete, the next opening completes it."""
        if load := self._loads.pop(name, None):
            self._report(load, end=True)
            load.packing.close()

    def close(self) -> None:
        """Ends both packers."""
        for name in list(self._loads):
            self._end(name)
