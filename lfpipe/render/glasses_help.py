"""A person's glasses: the question which they are (key e, and at the first start), and their test (key g)."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from lfpipe.config import Render, user_file
from lfpipe.render.display import Display
from lfpipe.render.glasses_test import GlassesTest
from lfpipe.render.overlay import Notices
from lfpipe.render.presenter import Presenter
from lfpipe.transport.clock import now_ns
from lfpipe.transport.context import Context

if TYPE_CHECKING:
    from lfpipe.render.glasses_question import GlassesQuestion

GHOST_STEP = 5.0  # %


class GlassesHelp:
    """Asks, tests and keeps the answers. choose_scene: opens the start page, which waits for the first answer and its test."""

    def __init__(
        self, context: Context, presenter: Presenter, display: Display, notices: Notices, choose_scene: Callable[[], None]
    ) -> None:
        self._context, self._presenter, self._display, self._notices = context, presenter, display, notices
        self._choose_scene = choose_scene
        self._question: GlassesQuestion | None = None
        self._test: GlassesTest | None = None
        self._chosen = ""  # value of render.anaglyph whose test follows
        self._scene_follows = context.options.start and context.options.ask_glasses

    def ask(self) -> None:
        """Shows the question over the picture."""
        from lfpipe.render.glasses_question import GlassesQuestion  # few sessions ask

        self._question = GlassesQuestion(self._context.config.render.anaglyph)
        self._display.menu(self._question.draw)

    def takes(self, event: str) -> bool:
        """Handles an event of the window; returns whether it was for the question or the test."""
        render = self._context.config.render
        if self._question is not None and event not in ("fullscreen", "help"):
            return self._answers(self._question, event, render)
        if event == "which":
            self.ask()
        elif event == "glasses" and self._question is None:
            self._switch_test(render)
        elif event in ("more", "less") and self._test is not None:
            ghost = render.ghost_compensation + (GHOST_STEP if event == "more" else -GHOST_STEP)
            self._context.request("set", set={"render.ghost_compensation": min(max(ghost, 0.0), 100.0)})
        else:
            return False
        return event != "glasses"  # the test closes a menu

    def _answers(self, question: "GlassesQuestion", event: str, render: Render) -> bool:
        kind = question.answer(event)
        if kind is None and question.understands(event):
            self._display.menu(question.draw)
            return True
        self._question = None
        self._display.menu(None)
        if kind is None and event not in ("choose", "which"):
            return False  # another key leaves the question for the next start
        if kind is not None:
            self._keep({"anaglyph": kind.anaglyph})
            self._context.request("set", set={"render.anaglyph": kind.anaglyph})
            self._chosen = kind.anaglyph if kind.lenses is not None else ""
            self.follow(render)
        if not self._chosen and self._test is None:
            self._go_on()
        return True

    def follow(self, render: Render) -> None:
        """Begins the test once the chosen setting is in force."""
        if self._chosen and render.anaglyph == self._chosen:
            self._chosen = ""
            self._switch_test(render)

    def words(self, render: Render) -> str:
        """The instructions of a running test, "" without one."""
        return self._test.words(render) if self._test is not None else ""

    def _switch_test(self, render: Render) -> None:
        """Begins or ends the test; at its end the changes are saved in the person's settings."""
        if self._test is None:
            self._test = GlassesTest(render)
        else:
            changed, self._test = self._test.changed(render), None
            self._keep(changed)
            self._go_on()
        self._presenter.pattern = self._test

    def _go_on(self) -> None:
        """Opens the start page that waits, once."""
        if self._scene_follows:
            self._scene_follows = False
            self._choose_scene()

    def _keep(self, values: Mapping[str, float | bool | str]) -> None:
        """Saves keys of [render] in the person's settings."""
        from lfpipe.config.user_files import write_keys

        try:
            write_keys(user_file(), "render", values)
        except (OSError, ValueError) as error:
            self._notices.say("kept", f"{user_file()}: not saved: {getattr(error, 'strerror', None) or error}", now_ns())
        else:
            if values:
                self._notices.say("kept", f"saved for the next session: {', '.join(map(_words, values))}", now_ns())


def _words(name: str) -> str:
    return {"anaglyph": "your glasses", "swap_eyes": "swapped eyes", "ghost_compensation": "compensation of ghosts"}.get(
        name, name
    )
