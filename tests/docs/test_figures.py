"""The figures of the architecture are those of the code."""

from tests.support.extras import with_extras
from tools import draw_imports, draw_pipeline


@with_extras
def test_figure_of_the_pipeline_is_current() -> None:
    for name, drawn in draw_pipeline.FIGURES.items():
        assert (draw_pipeline.DOCS / name).read_text() == drawn(), (
            "run: python -m tools.draw_pipeline"
        )


@with_extras
def test_figure_of_the_imports_is_current() -> None:
    assert draw_imports.OUT.read_text() == draw_imports.drawn(), "run: python -m tools.draw_imports"
