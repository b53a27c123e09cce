"""The look of pages: the reports of `lfpipe bench` and `lfpipe sweep`."""

import html
from collections.abc import Sequence

STYLE = """
:root { color-scheme: light dark; --paper: #ffffff; --ink: #1b1f24; --soft: #57606a; --line: #d8dde3; --mark: #f4f6f8;
  --red: #c62a2f; --ok: #d9f2e4; --degraded: #fdeccb; --failed: #fbd5d5; }
@media (prefers-color-scheme: dark) { :root { --paper: #14171c; --ink: #e8eaed; --soft: #a4abb5; --line: #333943; --mark: #1c2027;
  --red: #ff7b7f; --ok: #173c2b; --degraded: #4a3710; --failed: #561d20; } img { filter: invert(0.91) hue-rotate(180deg); } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem; max-width: 64rem; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; margin: 0 0 .2rem; }
h2 { margin: 2.6rem 0 .3rem; border-top: 1px solid var(--line); padding-top: 1.2rem; }
p { margin: .3rem 0 .8rem; } .soft { color: var(--soft); } nav a { margin-right: .9rem; } a { color: inherit; }
img { width: 100%; height: auto; display: block; margin: .6rem 0 1rem; border: 1px solid var(--line); border-radius: 6px; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .84rem; margin: .3rem 0 1rem; }
th, td { text-align: left; padding: .22rem .6rem; border-bottom: 1px solid var(--line); vertical-align: top; }
th { background: var(--mark); font-weight: 600; } summary { cursor: pointer; margin: .4rem 0; }
.front { font-weight: 600; } .paper { color: var(--red); } .ok { background: var(--ok); }
.degraded { background: var(--degraded); } .failed { background: var(--failed); }
code { font-size: .9em; overflow-wrap: anywhere; }
"""


def document(title: str, body: str) -> str:
    """A page that stands alone. body: HTML."""
    return (
        '<!doctype html><!-- written by lfpipe --><html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width"><title>{html.escape(title)}</title><style>{STYLE}</style></head>'
        f"<body><h1>{html.escape(title)}</h1>{body}</body></html>"
    )


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]], classes: Sequence[Sequence[str]] = ()) -> str:
    """An HTML table of texts. classes: of each cell; a row with one class has it for all."""
    body = ""
    for k, row in enumerate(rows):
        named = classes[k] if classes else ()
        cells = zip(row, named if len(named) > 1 else [*named, ""][:1] * len(row), strict=True)
        body += "<tr>" + "".join(f'<td class="{name}">{html.escape(text)}</td>' for text, name in cells) + "</tr>"
    return f'<div class="wide"><table><tr>{"".join(f"<th>{html.escape(text)}</th>" for text in head)}</tr>{body}</table></div>'
