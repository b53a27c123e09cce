"""What the supervisor prints of its stages' reports."""

from typing import Any

import pytest

from lfpipe.supervisor.live_session import Reports


@pytest.mark.parametrize("topic", ["parallax", "notice"])
def test_a_line_that_stands_on_the_terminal_is_not_repeated_for_alpha(topic: str) -> None:
    printed: list[Any] = []
    reports = Reports(printed.append)
    for alpha in (20, 22, 22):
        reports.hear({"topic": topic, "text": f"alpha {alpha} px/view\n  viewer 600 mm from the screen"})
    if topic == "notice":
        assert len(printed) == 3
    else:
        assert printed == ["alpha 20 px/view\n  viewer 600 mm from the screen", "alpha 22 px/view"]
