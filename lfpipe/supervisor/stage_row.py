"""A row of the process table, also for the entry points of the group `lfpipe.stages`."""

from collections.abc import Callable

import attrs

from lfpipe.config import SessionOptions
from lfpipe.transport.metrics import NO_METRICS, MetricSet


@attrs.frozen(kw_only=True)
class Stage:
    """A process."""

    name: str
    module: str
    """Contains `main(context)`."""
    needed: Callable[[SessionOptions], bool]
    """Whether a session with these options runs it."""
    reads: tuple[str, ...] = ()
    """Rings."""
    writes: tuple[str, ...] = ()
    """Rings."""
    asks_for: Callable[[SessionOptions], tuple[str, ...]] = lambda _: ()
    """The on-demand rings that it reads and needs with these options."""
    metrics: MetricSet = NO_METRICS
    """Declared in its own package."""
    optional: bool = False
    """Whether few sessions run it, and no picture waits for it."""
    of_viewer: bool = False
    """Whether it starts again for another viewer."""
    own_core: bool = False
    """Whether it avoids the first of two cores."""
    startup_timeout_s: float = 15.0
    """From spawn to READY, or to open another scene or camera."""
    hang_timeout_s: float = 2.0
    """Longest time without a heartbeat after that."""
