"""The table of angular super-resolution as Markdown, a page, and a diagram with the printed results as lines."""

import base64
import html
import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter

from lfpipe.bench.diagrams import DARK, LIGHT, MARKERS, Theme, short
from lfpipe.bench.published import HCI_NEW, HCI_OLD, ROWS, TEST_SCENES, THIRTY, set_of
from lfpipe.bench.report import STYLE
from lfpipe.bench.table import Line, Protocol
from lfpipe.errors import UserError, plain

HEAD = ("scene", "views", "method", "PSNR, dB", "worst view, dB", "SSIM", "ms a picture", "MB", "disparity, s")
PRINTED = "Printed by others for the test scenes of each set, not run here"


def about(protocol: Protocol) -> str:
    """The protocol in a sentence."""
    return (
        f"{protocol.keep}x{protocol.keep} views kept of the {protocol.crop} 7x7, the others made. Luma of BT.601 in studio range,"
        f" peak 255, {protocol.border_px} px shaved off each side; SSIM with a Gaussian of sigma 1.5; mean over the made views."
        " Disparity is of the kept views alone (time: last column). ms a picture: one view in colour, one core."
    )


def cells(line: Line) -> tuple[str, ...]:
    if line.left_out:
        return (line.scene, line.grid, f"left out: {line.left_out}", *[""] * 6)
    return (
        line.scene, line.grid, line.method, f"{line.psnr_db:.2f}", f"{line.worst_db:.2f}", f"{line.ssim:.4f}",
        f"{line.ms:.2f}", f"{line.mb:.1f}", f"{line.prepare_s:.1f}",
    )  # fmt: skip


def set_means(lines: Sequence[Line]) -> list[tuple[str, ...]]:
    """Means over a published set, for methods that were measured on all of its test scenes and with the printed grid."""
    rows: list[tuple[str, ...]] = []
    for name, scenes in TEST_SCENES.items():
        for method in dict.fromkeys(line.method for line in lines if not line.left_out):
            of = {line.scene.lower(): line for line in lines if line.method == method and set_of(line.scene) == name}
            if set(of) == set(scenes) and all(line.grid == "2x2 -> 7x7" for line in of.values()):
                figures = np.array([(line.psnr_db, line.worst_db, line.ssim, line.ms) for line in of.values()])
                db, _, structure, ms = (f"{v:.2f}" if k != 2 else f"{v:.4f}" for k, v in enumerate(figures.mean(axis=0)))
                rows.append((f"mean of {name}", "2x2 -> 7x7", method, db, f"{figures[:, 1].min():.2f}", structure, ms, "", ""))
    return rows


def markdown(lines: Sequence[Line], protocol: Protocol) -> str:
    """The table, and the printed results in a separate table."""

    def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
        wrote = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in (head, ["---"] * len(head), *rows)]
        return "\n".join(wrote) + "\n"

    ours = [tuple(plain(cell, 300) for cell in cells(line)) for line in lines] + set_means(lines)
    text = f"{about(protocol)}\n\n{table(HEAD, ours)}"
    if protocol.keep == 2:
        text += f"\n{PRINTED}:\n\n{table(('method', HCI_NEW, HCI_OLD, THIRTY, 'from'), _printed())}"
    return text


def _printed() -> list[tuple[str, ...]]:
    return [
        (row.method, *(f"{row.means[name][0]:.2f} / {row.means[name][1]:.3f}" for name in (HCI_NEW, HCI_OLD, THIRTY)), row.table)
        for row in ROWS
    ]


def draw(lines: Sequence[Line], protocol: Protocol, theme: Theme = LIGHT) -> Canvas:
    """PSNR over time: a panel for each published set, its printed means as lines. Scenes outside the set are hollow."""
    some = [line for line in lines if not line.left_out]
    panels = (HCI_NEW, HCI_OLD, THIRTY) if protocol.keep == 2 else ("",)
    scenes, methods = list(dict.fromkeys(one.scene for one in some)), list(dict.fromkeys(one.method for one in some))
    style = {
        "svg.hashsalt": "lfpipe", "font.size": 9, "text.color": theme.ink, "axes.labelcolor": theme.ink,
        "axes.edgecolor": theme.soft, "xtick.color": theme.soft, "ytick.color": theme.soft, "axes.facecolor": theme.paper,
        "figure.facecolor": theme.paper, "savefig.facecolor": theme.paper,
    }  # fmt: skip
    with mpl.rc_context(style):  # type: ignore[arg-type]
        canvas = Canvas(figsize=(5.2 * len(panels), 5.6), dpi=110, layout="constrained")
        for axes, panel in zip(np.ravel(canvas.subplots(1, len(panels), sharey=True, squeeze=False)), panels, strict=True):
            for k, scene in enumerate(scenes):
                colour = theme.curves[k % len(theme.curves)]
                of = sorted((one for one in some if one.scene == scene), key=lambda one: one.ms)
                axes.plot([one.ms for one in of], [one.psnr_db for one in of], color=colour, linewidth=0.8, label=scene)
                for one in of:
                    inside = set_of(scene) == panel and panel
                    marker = MARKERS[methods.index(one.method) % len(MARKERS)]
                    axes.plot(one.ms, one.psnr_db, marker, color=colour, markerfacecolor=colour if inside else "none")
            right = max((one.ms for one in some), default=1.0) * 1.1
            for row in sorted(ROWS, key=lambda row: row.means[panel][0]) if panel else ():
                axes.axhline(row.means[panel][0], color=theme.soft, linewidth=0.8, linestyle="--")
                axes.text(right, row.means[panel][0], f"{row.method} ({row.table}), not run here", fontsize=5.5, va="bottom",
                          ha="right", color=theme.soft)  # fmt: skip
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: short(value)))
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.set_xlabel("ms a picture, one core")
            axes.set_title(f"lines: means printed for {panel}" if panel else "", loc="left", fontsize=9)
            axes.grid(True, color=theme.grid, linewidth=0.8)
        canvas.axes[0].set_ylabel("PSNR of luma, dB")
        handles, labels = canvas.axes[0].get_legend_handles_labels()
        marks = [Line2D([], [], color=theme.soft, marker=MARKERS[k % len(MARKERS)], linestyle="") for k in range(len(methods))]
        canvas.legend([*handles, *marks], [*labels, *methods], loc="outside lower center", ncols=6, frameon=False)
        return canvas


def write(lines: Sequence[Line], protocol: Protocol, out: Path) -> Path:
    """Writes table.md, table.html and the diagram to out; returns the path of the page. Raises UserError."""
    try:
        text = markdown(lines, protocol)
        (out / "table.md").write_text(text)
        pictures = ""
        if any(math.isfinite(line.psnr_db) for line in lines):
            for theme in (LIGHT, DARK):
                draw(lines, protocol, theme).savefig(out / f"table-{theme.name}.png")
            draw(lines, protocol).savefig(out / "table.svg", metadata={"Date": None})
            light, dark = (base64.b64encode((out / f"table-{t.name}.png").read_bytes()).decode() for t in (LIGHT, DARK))
            pictures = (
                f'<picture><source media="(prefers-color-scheme: dark)" srcset="data:image/png;base64,{dark}">'
                f'<img alt="PSNR over time" src="data:image/png;base64,{light}"></picture>'
                "<p class=soft>Hollow points: scenes that are not of the set."
                " Dashed lines: printed by the paper named, not run here.</p>"
            )
        body = _html(HEAD, [*map(cells, lines), *set_means(lines)])
        if protocol.keep == 2:
            body += f"<h2>{PRINTED}</h2>" + _html(("method", HCI_NEW, HCI_OLD, THIRTY, "from"), _printed())
        page = out / "table.html"
        page.write_text(
            '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>lfpipe bench table</title>'
            f"<style>{STYLE}</style></head><body><h1>Views between: quality over time</h1><p>{html.escape(about(protocol))}</p>"
            f"{pictures}{body}</body></html>"
        )
        return page
    except OSError as error:
        raise UserError(f"{out}: cannot be written: {error.strerror}", "choose another folder with --out DIR") from None


def _html(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def row(tag: str, values: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(plain(value, 300))}</{tag}>" for value in values) + "</tr>"

    return f'<div class="wide"><table>{row("th", head)}{"".join(row("td", values) for values in rows)}</table></div>'
