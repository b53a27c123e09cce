"""The supervisor's front desk: takes messages, over ctl and from the network, sends answers, passes telemetry on to tap."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import zmq

from lfpipe.config import Control
from lfpipe.supervisor.commands import Client, Commands, House
from lfpipe.supervisor.intake import Intake
from lfpipe.transport import control, curve
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.session import Session

APPLY_LOOK_MS = 4  # how often it is looked at meanwhile


class Desk:
    """Three sockets, bound in the run directory, and one on the network where control.bind says so; nothing here waits.

    hear: takes what the stages tell. Raises UserError where a socket cannot be.
    """

    def __init__(
        self,
        ctx: zmq.Context[zmq.Socket[bytes]],
        session: Session,
        settings: Control,
        house: House,
        hear: Callable[[dict[str, Any]], None],
    ) -> None:
        self._house, self._hear, self.commands = house, hear, Commands(house, self._answer)
        run_dir = session.run_dir
        self._ctl, self._bus, self._tap = (ctx.socket(kind) for kind in (zmq.ROUTER, zmq.PULL, zmq.XPUB))
        self._ctl.setsockopt(zmq.ROUTER_HANDOVER, 1)  # a restarted stage comes back under its old name
        for socket, name in ((self._ctl, "ctl"), (self._bus, "bus"), (self._tap, "tap")):
            control.limit(socket)
            socket.bind(control.address(run_dir, name))
            (run_dir / name).chmod(0o600)
        self._door = curve.Door(settings.bind, curve.folder(settings.keys)) if settings.bind != "ipc" else None
        self._ordered, self._told = [Intake(self._ctl)], Intake(self._bus)
        self._asked: list[Intake] = []
        if self._door is not None:
            self._ordered.append(Intake(self._door.ctl))
            self._asked.append(Intake(self._door.bell))
        self._intakes = [*self._ordered, self._told, *self._asked]
        self._news: dict[str, dict[str, Any]] | None = None  # while messages are taken: only the last configuration counts

    def close(self) -> None:
        """Ends what is under way; the answer to it is an error."""
        self.commands.close()
        for socket in (self._ctl, self._bus, self._tap):
            socket.close()
        if self._door is not None:
            self._door.close()

    @property
    def sockets(self) -> list[zmq.Socket[bytes]]:
        """Those worth waking for now."""
        return [intake.socket for intake in self._intakes if not intake.rest_ns()]

    def wait_ms(self, most_ms: int) -> int:
        """How long the supervisor may sleep, most_ms at the most, where none of `sockets` wakes it."""
        rests = [intake.rest_ns() // MS_NS + 1 for intake in self._intakes if intake.rest_ns()]
        return min([most_ms, *rests, *([APPLY_LOOK_MS] if self.commands.waited_for else [])])

    def send(self, stage: str, message: dict[str, Any]) -> None:
        """To one stage; lost if it is not connected (it says hello when it is)."""
        if self._news is not None and message["cmd"] == "config":
            self._news[stage] = message
            return
        self._ctl.send_multipart([stage.encode(), control.encode(message)], zmq.NOBLOCK)

    def publish(self, topic: str, **values: Any) -> None:
        """To whoever listens on the tap."""
        self._tap.send(control.encode({"topic": topic, "t_ns": now_ns(), **values}), zmq.NOBLOCK)

    def serve(self) -> None:
        """Takes what has arrived, as far as its time goes."""
        self._news = {}
        for intake in self._ordered:
            for identity, *parts in intake.messages():
                self.commands.take(Client(intake.socket, identity, intake.socket is self._ctl), parts)
        for (data,) in (parts for parts in self._told.messages() if len(parts) == 1):
            with contextlib.suppress(control.BadMessage):
                message = control.decode(data)
                self._tap.send(data, zmq.NOBLOCK)
                self._hear(message)
        for question in (parts for intake in self._asked for parts in intake.messages()):
            assert self._door is not None
            self._door.answer(question)
        while self._tap.poll(0):
            self._tap.recv()  # who subscribes and leaves is told to us, and would be kept
        self.commands.finish()
        news, self._news = self._news, None
        for stage, message in news.items():
            self.send(stage, message)

    def _answer(self, client: Client, message: dict[str, Any]) -> None:
        data = control.encode({"rev": self._house.agreement.rev, **message})
        client.socket.send_multipart([client.identity, data], zmq.NOBLOCK)
