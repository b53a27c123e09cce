"""`lfpipe calibrate --latency`."""

import datetime
from collections.abc import Callable
from typing import Any

from lfpipe.capture.open_source import camera_name
from lfpipe.cli.terminal import print_result, with_config
from lfpipe.config import Config, user_file
from lfpipe.config.check import write_keys
from lfpipe.extras.latency.calibration import measure_device_latency
from lfpipe.render.display.window_system import device_latency_conditions


def calibrate(proceed: Callable[..., Any], *, latency: bool, **values: Any) -> Any:
    """Measures the latency of camera and display instead of the focal length."""
    return _measure(**values) if latency else proceed(**values)


@with_config
def _measure(camera: str | None, config: Config, **_: Any) -> None:
    """Measures and stores render.device_latency_ms."""
    name = camera_name(camera or config.camera.source)
    delay, monitor = measure_device_latency(config, camera)
    device_latency_ms = round(max(delay.delay_ms, 0.0), 1)
    print_result(
        f"total delay of camera and display: {device_latency_ms} ms (90 %: {delay.low_ms:.1f} to"
        f" {delay.high_ms:.1f} ms)"
    )
    print_result(
        f"exposure {delay.exposure_ms:.0f} ms, on monitor {monitor.name} at {monitor.rate_hz:g} Hz"
    )
    here = device_latency_conditions(name, config.camera, monitor)
    today = datetime.date.today().isoformat()
    write_keys(
        user_file(),
        "render",
        {"device_latency_ms": device_latency_ms, "device_latency_measured": f"{today}; {here}"},
    )
    print_result(
        f"render.device_latency_ms written to {user_file()}: the next session predicts by it"
    )
