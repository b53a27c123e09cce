"""A change of configuration or scene on trial: a stage that cannot work by it has it taken back, whole."""

from __future__ import annotations

from typing import Any

from lfpipe.config import Config
from lfpipe.supervisor.child import EXIT_TERMINATED
from lfpipe.transport.clock import SECOND_NS

TRIAL_NS = 2 * SECOND_NS  # from when all stages work by a change; one that cannot does not live so long
KEPT = ("pack", "tracking")  # the options that `load` changes; all others the supervisor's own doing


class Trial:
    """Holds what the session is known to work by. config, options: as it starts."""

    def __init__(self, config: Config, options: dict[str, Any]) -> None:
        self._good = config, self._kept(options)
        self._since_ns: int | None = None
        self._made: dict[str, int] = {}

    @staticmethod
    def _kept(options: dict[str, Any]) -> dict[str, Any]:
        return {name: options[name] for name in KEPT if name in options}

    def watch(self, config: Config, options: dict[str, Any], applied: bool, made: dict[str, int], t_ns: int) -> None:
        """Call often: what every stage has worked by for TRIAL_NS, and made something by, is good. made: outputs of each."""
        if self._good == (config, self._kept(options)) or not applied:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns, self._made = t_ns, made
        elif t_ns - self._since_ns >= TRIAL_NS and all(count > self._made.get(name, 0) for name, count in made.items()):
            self._good, self._since_ns = (config, self._kept(options)), None

    def verdict(self, config: Config, options: dict[str, Any], code: int, applied: bool) -> tuple[Config, dict[str, Any]] | None:
        """What to go back to, (config, options), where a stage that ended with code most likely ended over the change; else None.

        applied: it had said that it works by the change; then only an error of its own tells against that.
        """
        own = code > 0 and code != EXIT_TERMINATED
        if self._good == (config, self._kept(options)) or (applied and not own):
            return None
        self._since_ns = None
        return self._good[0], {**options, **self._good[1]}
