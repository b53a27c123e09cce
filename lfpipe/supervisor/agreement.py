"""What a session works by: configuration, options and whether it pauses. A change is taken whole and has a revision."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lfpipe import config as config_module
from lfpipe.config import Config
from lfpipe.supervisor.levels import Levels
from lfpipe.supervisor.loan import PacketLoan, PictureLoan
from lfpipe.supervisor.table import picture_ring
from lfpipe.transport.session import Session


class Agreement:
    """Of one session. options: what stages need to know besides the configuration, plain values (`up.options`).

    tell: takes the message that every stage is to hear after a change.
    """

    def __init__(
        self, session: Session, config: Config, options: dict[str, Any], levels: Levels, tell: Callable[[dict[str, Any]], None]
    ) -> None:
        self.config, self.options, self.levels, self._tell = config, options, levels, tell
        self.rev, self.paused = 1, False
        self._pictures, self._packets = PictureLoan(session), PacketLoan(session)

    def begin(self) -> None:
        """Makes the ring that the options ask for at once. Raises UserError where memory is short."""
        self.options = self._packets.follow(self.config, self.options)

    def change(self, config: Config | None = None, options: dict[str, Any] | None = None, paused: bool | None = None) -> int:
        """Takes a checked change as a whole and tells every stage; returns its revision.

        Raises UserError, and changes nothing, where there is no memory for the ring of a recording.
        """
        self.options = self._packets.follow(self.config, self.options if options is None else options)
        self.config = self.config if config is None else config
        self.paused = self.paused if paused is None else paused
        self.levels.follow(self.config, self.options)
        self.options = {**self.options, "level": self.levels.now.option()}
        self.rev += 1
        self._tell(self.message())
        return self.rev

    def message(self) -> dict[str, Any]:
        """What a stage must know to work as the session does now."""
        return {
            "cmd": "config",
            "rev": self.rev,
            "config": config_module.to_dict(self.config),
            "options": self.options,
            "paused": self.paused,
        }

    def lend_pictures(self, lease_s: float) -> tuple[str, bool]:
        """Has render write its pictures to a ring for lease_s from now: the ring's name, and whether that is a change.

        Raises UserError where memory is short.
        """
        changed = self._pictures.renew(picture_ring(self.options), lease_s)
        if changed:
            self.change(options={**self.options, "pictures": self._pictures.part})
        return self._pictures.part, changed

    def end_overdue(self) -> None:
        """Takes back the ring of pictures that nobody asks for any more."""
        if self._pictures.overdue():
            self._pictures.end()
            self.change(options={**self.options, "pictures": ""})

    def end(self) -> None:
        """Removes the rings that are lent."""
        self._pictures.end()
        self._packets.end()
