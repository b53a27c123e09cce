"""What a call refuses."""

from collections.abc import Callable

import pytest

from lfpipe.errors import UserError


def refusal(call: Callable[..., object], *args: object, **named: object) -> UserError:
    """The error that a call raises for the user; it has a remedy."""
    with pytest.raises(UserError) as caught:
        call(*args, **named)
    assert caught.value.remedy
    return caught.value
