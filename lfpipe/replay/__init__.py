"""Deterministic replay of recorded sequences, and the comparison with a reference.

The package itself can be called: `lfpipe.replay(SEQ)` is `subprocess_run.replay`. A package and a function cannot share the name
`lfpipe.replay` otherwise, for importing a module of the package puts it in the function's place.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class _CallableModule(ModuleType):
    def __call__(self, *args: Any, **more: Any) -> dict[str, Any]:
        from lfpipe.replay.subprocess_run import replay

        return replay(*args, **more)


sys.modules[__name__].__class__ = _CallableModule
