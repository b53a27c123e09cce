"""The findings of a run, one line per subject: the least error and the shortest time, compared with the paper's method."""

from lfpipe.bench.diagrams import Point, points, short
from lfpipe.bench.model import Diagram, Subject
from lfpipe.bench.results import SubjectResults
from lfpipe.bench.stats import pareto


def conclusion(subject: Subject, found: SubjectResults) -> str:
    """The finding of a subject in one line; failures come first."""
    cells = [cell.state for table in found.tables for row in table.rows for cell in row]
    failed = len(found.omissions) + cells.count("failed")
    said = [f"{failed} failed"] if failed else []
    diagram = next((each for each in subject.diagrams if isinstance(each, Diagram)), None)
    if diagram is not None and (shown := points(subject, found, diagram)):
        said.append(_best(subject, diagram, shown))
    if cells:
        said += [f"{cells.count(state)} {state}" for state in ("ok", "degraded") if cells.count(state)]
    return "; ".join(said) or "nothing measured"


def _best(subject: Subject, diagram: Diagram, shown: list[Point]) -> str:
    """The candidate with the least error, and the paper's."""
    papers = [point for point in shown if point.one.paper]
    front = [shown[k] for k in pareto([(p.x, p.y) for p in shown])]
    paper = min(papers, key=lambda p: p.y, default=None)
    best = min(front, key=lambda p: p.y)
    fx, fy = subject.figure(diagram.x), subject.figure(diagram.y)
    text = f"least {fy.axis}: {best.one.name}, {_value(best, 'y')} ({fx.axis}: {_value(best, 'x')})"
    if paper is None or paper is best:
        return text + (", which is the paper's way" if paper is best else "")
    return f"{text}; the paper's way, {paper.one.name}: {_value(paper, 'y')} ({_value(paper, 'x')})"


def _value(point: Point, axis: str) -> str:
    at = 0 if axis == "x" else 1
    return "0" if point.zero[at] else short((point.x, point.y)[at])
