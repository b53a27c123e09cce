"""How many examples a property draws."""

from typing import Any

from hypothesis import settings


def examples(count: int, **more: Any) -> settings:
    """So many, less in a profile that has less than 100 by itself."""
    return settings(max_examples=max(1, count * settings().max_examples // 100), **more)
