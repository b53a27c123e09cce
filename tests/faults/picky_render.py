"""`lfpipe` with a render stage that fails with some settings, and one that dies again and again.

render.device_latency_ms = 7: it ends with a UserError after it has confirmed the setting; 8: with
another error; 9: always, at its first picture.
"""

from typing import Any

import attrs

from lfpipe.errors import UserError
from lfpipe.render import presenter, stage
from lfpipe.supervisor import process_table
from lfpipe.transport.context import Context


def main(context: Context) -> None:
    usual = presenter.Presenter.show

    def show(self: presenter.Presenter, *args: Any, **more: Any) -> None:
        device_latency_ms = context.config.render.device_latency_ms
        if device_latency_ms == 7:
            raise UserError("render.device_latency_ms = 7: not for me", "another number")
        if device_latency_ms in (8, 9):
            raise ZeroDivisionError(f"show at {device_latency_ms:g}")
        usual(self, *args, **more)

    presenter.Presenter.show = show  # type: ignore[method-assign]
    stage.main(context)


if __name__ == "__main__":
    process_table.STAGES = tuple(
        attrs.evolve(each, module="tests.faults.picky_render") if each.name == "render" else each
        for each in process_table.STAGES
    )
    from lfpipe.cli import run

    run()
