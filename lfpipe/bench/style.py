"""The style of pages: reports of `lfpipe bench` and `lfpipe sweep`."""

STYLE = """
:root { color-scheme: light dark; --paper: #ffffff; --ink: #1b1f24; --soft: #57606a; --line: #d8dde3; --mark: #f4f6f8;
  --red: #c62a2f; --ok: #d9f2e4; --degraded: #fdeccb; --failed: #fbd5d5; }
@media (prefers-color-scheme: dark) { :root { --paper: #14171c; --ink: #e8eaed; --soft: #a4abb5; --line: #333943; --mark: #1c2027;
  --red: #ff7b7f; --ok: #173c2b; --degraded: #4a3710; --failed: #561d20; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem; max-width: 64rem; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; margin: 0 0 .2rem; }
h2 { margin: 2.6rem 0 .3rem; border-top: 1px solid var(--line); padding-top: 1.2rem; }
h3 { margin: 1.4rem 0 .3rem; font-size: 1rem; } p { margin: .3rem 0 .8rem; } .soft { color: var(--soft); }
nav a { margin-right: .9rem; } a { color: inherit; }
img { width: 100%; height: auto; display: block; margin: .6rem 0 1rem; border: 1px solid var(--line); border-radius: 6px; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .84rem; margin: .3rem 0 1rem; }
th, td { text-align: left; padding: .22rem .6rem; border-bottom: 1px solid var(--line); vertical-align: top; }
th { background: var(--mark); font-weight: 600; }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.front { font-weight: 600; } .paper { color: var(--red); } .ok { background: var(--ok); }
.degraded { background: var(--degraded); }
.failed { background: var(--failed); } summary { cursor: pointer; margin: .4rem 0; }
code { font-size: .9em; overflow-wrap: anywhere; }
"""
