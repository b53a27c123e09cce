"""The look of pages: the reports of `lfpipe bench` and `lfpipe sweep`."""

import html
import itertools
from collections.abc import Sequence

STYLE = """
:root { color-scheme: light dark; }
body { margin: 0 auto; padding: 1.5rem; max-width: 64rem; font: 16px/1.5 system-ui, sans-serif; }
a { color: inherit; }
h2 { margin: 2.6rem 0 .3rem; border-top: 1px solid #8886; padding-top: 1.2rem; }
p { margin: .3rem 0 .8rem; }
.soft { opacity: .75; }
.lead { font-size: 1.1rem; margin: 1.2rem 0 1rem; }
nav a { margin-right: .9rem; }
img { width: 100%; margin: .6rem 0 1rem; border-radius: 6px; background: #fff; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .84rem; margin: .3rem 0 1rem; }
th, td {
  text-align: left; padding: .22rem .6rem; border-bottom: 1px solid #8886; vertical-align: top;
}
th { background: #8882; }
@media (max-width: 40rem) { .cards td { display: block; } .cards tr:first-child { display: none; } }
.used { font-weight: 600; } .paper { color: #e5484d; }
.ok { background: #30a46c40; }
.degraded { background: #ffb22440; }
.failed { background: #e5484d40; }
summary { cursor: pointer; margin: .4rem 0; } code { font-size: .9em; overflow-wrap: anywhere; }
"""


def document(title: str, body: str) -> str:
    """A self-contained page. body: HTML."""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head>"
        f"<body><h1>{html.escape(title)}</h1>{body}</body></html>"
    )


def html_table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    classes: Sequence[Sequence[str]] = (),
    of: str = "",
) -> str:
    """An HTML table of texts. classes: of each cell. of: the class of the table."""
    body = ""
    for row, names in itertools.zip_longest(rows, classes, fillvalue=()):
        cells = itertools.zip_longest(row, names, fillvalue="")
        texts = (f'<td class="{name}">{html.escape(text)}</td>' for text, name in cells)
        body += f"<tr>{''.join(texts)}</tr>"
    titles = "".join(f"<th>{html.escape(text)}</th>" for text in head)
    return f'<div class="wide"><table class="{of}"><tr>{titles}</tr>{body}</table></div>'
