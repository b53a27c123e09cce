"""Short texts in the picture: changes for two seconds, conditions for as long as they last."""

from lfpipe.transport.clock import SECOND_NS

SHOWN_NS = 2 * SECOND_NS


class Notices:
    """Lines by subject: a new line replaces the previous one of its subject."""

    def __init__(self) -> None:
        self._passing: dict[str, tuple[str, int]] = {}  # subject -> (text, end)
        self._states: dict[str, str] = {}

    def say(self, subject: str, text: str, t_ns: int, shown_ns: int = SHOWN_NS) -> None:
        """Shows text for shown_ns."""
        self._passing.pop(subject, None)  # the newest comes last
        self._passing[subject] = (text, t_ns + shown_ns)

    def state(self, subject: str, text: str) -> None:
        """Shows text until it is empty."""
        if text:
            self._states[subject] = text
        else:
            self._states.pop(subject, None)

    def lines(self, t_ns: int) -> list[str]:
        """The lines to show at t_ns."""
        self._passing = {subject: each for subject, each in self._passing.items() if each[1] > t_ns}
        texts = [*(text for text, _ in self._passing.values()), *self._states.values()]
        return [line for text in texts for line in text.splitlines()]
