"""Deterministic replay of recorded sequences, and comparison with a reference.

The package itself can be called: `lfpipe.replay(SEQ)` is `subprocess_run.replay`. Otherwise importing a module of the package
would replace the function of the same name.
"""

import sys
from types import ModuleType
from typing import Any


class _CallableModule(ModuleType):
    def __call__(self, *args: Any, **more: Any) -> dict[str, Any]:
        from lfpipe.replay.subprocess_run import replay

        return replay(*args, **more)


sys.modules[__name__].__class__ = _CallableModule
