"""The state of a session: one frozen value. Every change is a pure function from one state to the
next. `SessionStore` keeps the newest state with the shared memory that it needs, which only the
supervisor creates and removes.
"""

from __future__ import annotations

import contextlib
import gc
import os
import secrets
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Literal

import attrs

from lfpipe.config import (
    Config,
    DrawingCosts,
    QualityLevel,
    Render,
    SceneSummary,
    SessionOptions,
    Snapshot,
    converter,
)
from lfpipe.config.quality import first_level, quality_levels
from lfpipe.config.session_options import Lossless, watching
from lfpipe.host.files import Segment, make_fifo
from lfpipe.live.records import live_rings
from lfpipe.scene.pack import hold_pack
from lfpipe.supervisor.process_table import (
    LASTING,
    METRICS,
    ON_DEMAND,
    asked_for,
    consumers,
    picture_ring,
    rings,
    written,
)
from lfpipe.transport import control, ring, status
from lfpipe.transport.control import Message, Session
from lfpipe.transport.ring import RingSpec

# the options that a stage may fail on; with the configuration, they can be rolled back
REVERTIBLE = ("scene", "viewer", "playlist", "playlist_at")


@attrs.frozen(kw_only=True)
class SessionState:
    """The state of a session. The stages use config, options and paused."""

    config: Config
    options: SessionOptions
    known_good: Mapping[str, Any] = attrs.field(
        default=attrs.Factory(lambda self: self.revertible, takes_self=True)
    )
    """The part that is known to work."""
    paused: bool = False
    rev: int = 1
    """Counts changes."""
    pictures_until_ns: int = 0
    """End of the lease of the ring of pictures; 0 without one."""
    pictures_px: tuple[int, int] = (0, 0)
    """(height, width) of that ring."""
    zero_planes_px: Mapping[str, float | Literal["auto"]] = attrs.field(factory=dict)
    """Zero planes of earlier scenes, by pack."""

    @classmethod
    def first(cls, config: Config, options: SessionOptions) -> SessionState:
        """The state at the start of a session."""
        return cls(config=config, options=options)._with_rings()

    @property
    def revertible(self) -> Mapping[str, Any]:
        """The part of the current state that can be rolled back, as arguments of `changed`."""
        return {"config": self.config, **{name: getattr(self.options, name) for name in REVERTIBLE}}

    @property
    def idle(self) -> bool:
        """Whether the session is paused, or nobody looks."""
        return self.paused or self.options.idle

    @property
    def levels(self) -> tuple[QualityLevel, ...]:
        """The quality levels allowed here; only full quality if nothing may depend on load."""
        all_levels = quality_levels(self.config, self.options)
        fixed = isinstance(self.options.clock, Lossless) or self.config.governor.quality == "fixed"
        return all_levels[:1] if fixed else all_levels

    @property
    def level(self) -> QualityLevel:
        """The current level."""
        return self.options.level or self.levels[0]

    @property
    def best_level(self) -> int:
        """The number of the best level whose pictures fit the display's period."""
        return first_level(self.config, self.options, self.levels)

    def replaces_revertible_of(self, earlier: SessionState) -> bool:
        """Whether this state, one change after an earlier one, may be rolled back: the change has
        set a revertible setting, perhaps to an equal value.
        """
        before = earlier.revertible
        return any(part is not before[name] for name, part in self.revertible.items())

    def message(self) -> Message:
        """The control message for the stages."""
        snapshot = Snapshot(
            rev=self.rev, config=self.config, options=self.options, paused=self.paused
        )
        return {"cmd": "config", **converter().unstructure(snapshot)}

    def rings(self) -> dict[str, RingSpec]:
        """The on-demand rings that this state needs, by name."""
        rings = {name: ON_DEMAND[name] for name in self.options.asked_for}
        if (live := self.options.live) is not None:
            rings |= written(self.options, live_rings(live))
        if self.options.pictures:
            rings[self.options.pictures] = picture_ring(*self.pictures_px)
        return rings

    # Changes. Each returns a new state with a new revision.

    def changed(
        self, config: Config | None = None, paused: bool | None = None, **options: Any
    ) -> SessionState:
        """With another configuration, pause or options.

        If that changes the quality levels, quality is full again.
        """
        config = self.config if config is None else config
        paused = self.paused if paused is None else paused
        new = attrs.evolve(self, config=config, paused=paused, rev=self.rev + 1)._with(**options)
        if new.options.scene is not None:
            new = new._with(scene=new.options.scene.shown_as(config.scene.invert_depth))
        if new.levels != self.levels:
            new = new._with(level=None)
        return new._with_rings()

    def _with(self, **options: Any) -> SessionState:
        return attrs.evolve(self, options=attrs.evolve(self.options, **options))

    def loaded(
        self,
        scene: SceneSummary,
        playlist_at: int | None = None,
        playlist: tuple[str, ...] | None = None,
    ) -> SessionState:
        """With another scene, at its last zero plane or the default: zero planes are in px of their
        scene. The depth order is the earlier choice for that scene. playlist_at: its index; None if
        it is not in the playlist. playlist: another one; None for the same.
        """
        old = self.options.scene
        config = self.config
        zero_planes_px = self.zero_planes_px
        if old is not None and old.pack != scene.pack:
            zero_planes_px = {**zero_planes_px, old.pack: config.render.zero_plane_px}
            zero_plane_px = zero_planes_px.get(scene.pack, Render().zero_plane_px)
            render = attrs.evolve(config.render, zero_plane_px=zero_plane_px)
            order = attrs.evolve(config.scene, invert_depth="auto")
            config = attrs.evolve(config, render=render, scene=order)
        new = self.changed(
            config,
            scene=scene,
            live=None,
            viewer=watching(self.options.viewer, scene.needs_eyes),
            playlist=self.options.playlist if playlist is None else playlist,
            playlist_at=self.options.playlist_at if playlist_at is None else playlist_at,
        )
        return attrs.evolve(new, zero_planes_px=zero_planes_px)

    def without(self, unusable: Mapping[str, str], but: str = "") -> SessionState:
        """With scenes that cannot be opened, and why; but: one that can. Same revision."""
        reasons = {**self.options.unusable, **unusable}
        return self._with(unusable={path: why for path, why in reasons.items() if path != but})

    def with_level(self, number: int) -> SessionState:
        """At another level of quality."""
        return self.changed(level=self.levels[number] if number else None)

    def with_costs(self, costs: DrawingCosts) -> SessionState:
        """With the measured costs of drawing: at the best level that fits the display's period, or
        at a lower one that is in use.
        """
        new = self.changed(costs=costs)
        in_use = min(self.level.number, new.levels[-1].number)
        return new.with_level(max(new.best_level, in_use))

    def with_pictures(self, until_ns: int) -> SessionState:
        """With the ring of pictures leased at least until then; self if only the lease is
        extended.
        """
        scene = self.options.scene
        assert scene is not None
        until_ns = max(until_ns, self.pictures_until_ns)
        size_px = (scene.height_px, scene.width_px)
        if self.options.pictures and size_px == self.pictures_px:
            return attrs.evolve(self, pictures_until_ns=until_ns)
        # a name that was never used, so that no reader maps an old ring
        new = self.changed(pictures=f"pictures.{secrets.token_hex(4)}")
        return attrs.evolve(new, pictures_until_ns=until_ns, pictures_px=size_px)

    def without_pictures(self) -> SessionState:
        """Without the ring of pictures."""
        return attrs.evolve(self.changed(pictures=""), pictures_until_ns=0)

    def settled(self) -> SessionState:
        """With the current part marked as known to work; same revision."""
        return attrs.evolve(self, known_good=self.revertible)

    def rolled_back(self) -> SessionState:
        """With the part that is known to work; all else unchanged."""
        return self.changed(**self.known_good)

    def _with_rings(self) -> SessionState:
        """With the rings that stages request."""
        rings = asked_for(self.options)
        return self if rings == self.options.asked_for else self._with(asked_for=rings)


class SessionStore:
    """Stores the state of a session. The pack of the state is held, so that `lfpipe scene clean`
    does not remove it while the stage that shows it restarts.

    state: the current state; its rings exist, with the FIFOs that wake their readers. table: the
    status table; drop all references to its rows before `close`. Raises UserError if memory is
    short, OSError if no FIFO can be created, and then leaves nothing behind.
    """

    def __init__(self, session: Session, state: SessionState) -> None:
        self.state = state
        self._session = session
        self._unsent: bytes | None = None
        self._rings: dict[str, Segment] = {}
        self._pack = contextlib.ExitStack()
        with contextlib.ExitStack() as undo:
            self._status = status.create(session.segment("status"), METRICS)
            undo.callback(self._status.remove)
            undo.callback(self._keep, ())
            undo.callback(self._pack.close)
            self._hold(state.options.pack)
            self._make(self._specs(state))
            for name, readers in consumers().items():
                for reader in readers:
                    make_fifo(session.wake(name, reader))
                    make_fifo(session.credit(name, reader))
            self.table = status.Table(session.segment("status"), writable=True)
            self._memory = undo.pop_all()

    def apply(self, state: SessionState) -> None:
        """Stores a state; `next_message` returns a new revision for the stages.

        Raises UserError if memory is short, BadMessage if the stages could not read it; then
        nothing has changed.
        """
        message = control.encode(state.message()) if state.rev != self.state.rev else self._unsent
        specs = self._specs(state)
        self._make(specs)
        if state.options.pack != self.state.options.pack:
            self._hold(state.options.pack)
        self.state = state
        self._unsent = message
        self._keep({*specs, *LASTING})

    @staticmethod
    def _specs(state: SessionState) -> dict[str, RingSpec]:
        return rings(state.config, state.options) | state.rings()

    def _hold(self, pack: str) -> None:
        """Holds another pack, or none (""); a pack that cannot be held fails when it is shown."""
        self._pack.close()
        with contextlib.suppress(OSError, ValueError):
            if pack:
                self._pack.callback(os.close, hold_pack(Path(pack)))

    def _make(self, specs: Mapping[str, RingSpec]) -> None:
        """Creates rings that do not exist yet: all, or none and a UserError if memory is short."""
        before = set(self._rings)
        try:
            for name in specs.keys() - before:
                self._rings[name] = ring.create(self._session.segment(name), specs[name])
        except BaseException:
            self._keep(before)
            raise

    def _keep(self, names: Collection[str]) -> None:
        """Removes the other rings; existing mappings stay valid."""
        for name in self._rings.keys() - names:
            self._rings.pop(name).remove()

    def next_message(self) -> bytes | None:
        """The newest state as a message for every stage, once; None if already sent. Of several
        changes, only the last is sent.
        """
        message = self._unsent
        self._unsent = None
        return message

    def close(self) -> None:
        """Unlinks every segment; the FIFOs are removed with the directory."""
        gc.collect()
        # An exception that ends the session still references rows; its mapping ends with it.
        with contextlib.suppress(BufferError):
            self.table.close()
        self._memory.close()
