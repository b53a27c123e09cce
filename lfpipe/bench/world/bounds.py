"""What `lfpipe bench viewer --check` demands of each script."""

import attrs

from lfpipe.bench.results import Results, Row, Value, short

FIGURES = (
    "error_views",
    "error_p95",
    "step_cols",
    "step_rows",
    "step_cols_0",
    "step_rows_0",
    "right_s",
    "depth",
    "lag_ms",
    "late",
    "levels",
    "seen",
)
LEAST = ("depth",)
Bounds = tuple[float | None, ...]
BOUNDS: dict[str, Bounds] = {
    "sits": (0.013, 0.02, 0.061, 0.05, 0.061, 0.05, None, 98, None, None, 5.6, 2.1),
    "sways at 0.5 Hz": (0.14, 0.29, 0.28, 0.23, 0.099, 0.11, None, 98, 15, None, 7.5, 2.8),
    "sways at 1 Hz": (0.35, 0.73, 0.37, 0.41, 0.16, 0.19, None, 98, 27, None, 9.4, 3.6),
    "sways at 2 Hz": (0.85, 1.5, 0.29, 0.38, 0.25, 0.3, None, 98, 65, None, 17.0, 6.6),
    "steps": (0.24, 1.1, 0.41, 0.24, 0.39, 0.12, None, 98, 72, None, 8.6, 3.3),
    "shakes": (1.1, 2.0, 0.39, 0.14, 0.34, 0.11, None, 98, 31, None, 18.0, 6.9),
    "leans out": (0.13, 0.6, 0.35, 0.21, 0.12, 0.14, 0.25, 98, 16, None, 6.9, 2.6),
    "leans in": (0.13, 0.41, 0.092, 0.051, 0.092, 0.051, None, 84, None, None, 6.5, 2.5),
    "leaves sideways": (0.18, 0.84, 0.08, 0.22, 0.08, 0.086, None, 98, 66, None, 13.0, 4.8),
    "half out of the picture": (0.056, 0.34, 0.31, 0.31, 0.093, 0.31, 0.25, 98, 67, None, 6.0, 2.3),
    "another takes over": (0.026, 0.069, 0.31, 0.31, 0.31, 0.31, 0.056, 98, 38, None, 5.6, 2.1),
    "back elsewhere after 2 s": (0.82, 4.8, 0.42, 0.38, 0.39, 0.38, 1.1, 98, 66, None, 12.0, 4.3),
    "back elsewhere after 12 s": (
        0.051,
        0.087,
        0.37,
        0.31,
        0.22,
        0.31,
        0.056,
        98,
        66,
        None,
        5.7,
        2.2,
    ),
    "walks in": (0.018, 0.026, 0.35, 0.16, 0.21, 0.12, 0.056, 98, None, None, 5.8, 2.2),
    "found at the border": (0.018, 0.024, 0.36, 0.05, 0.36, 0.05, None, 98, None, None, 5.5, 2.1),
    "confidence falls while moving": (
        0.017,
        0.025,
        0.31,
        0.15,
        0.2,
        0.089,
        0.056,
        98,
        34,
        None,
        5.6,
        2.1,
    ),
    "hidden for 0.3 s": (0.074, 0.037, 0.31, 0.093, 0.31, 0.064, 0.25, 98, None, None, 3.6, 1.3),
    "one frame wrong by .12": (0.076, 0.27, 0.58, 0.095, 0.58, 0.075, 0.31, 98, 88, None, 6.2, 2.3),
    "one frame wrong by .58": (0.04, 0.16, 0.16, 0.09, 0.11, 0.07, 0.064, 98, 49, None, 5.7, 2.1),
    "one eye wrong by .28": (0.088, 0.28, 0.62, 0.11, 0.62, 0.075, 0.31, 98, 93, None, 6.2, 2.3),
    "two frames wrong by .58": (0.12, 0.57, 0.77, 0.087, 0.82, 0.074, 0.44, 98, 77, None, 6.9, 2.6),
    "two people and a passer-by": (
        0.13,
        0.26,
        0.25,
        0.26,
        0.12,
        0.086,
        None,
        98,
        18,
        None,
        7.1,
        2.7,
    ),
    "portrait first": (0.12, 0.28, 0.72, 0.72, 0.72, 0.72, 0.1, 98, 44, None, 7.5, 2.8),
    "demo, warp2": (None, None, None, None, None, None, None, None, None, None, 6.6, 2.4),
    "demo, warp": (None, None, None, None, None, None, None, None, None, None, 6.8, 2.5),
    "demo, blend": (None, None, None, None, None, None, None, None, None, None, 9.9, 3.8),
    "demo, nearest": (None, None, None, None, None, None, None, None, None, None, 14.0, 5.0),
    "wide baseline, warp2": (None, None, None, None, None, None, None, None, None, None, 17.0, 6.2),
    "wide baseline, warp": (None, None, None, None, None, None, None, None, None, None, 19.0, 6.8),
    "wide baseline, blend": (None, None, None, None, None, None, None, None, None, None, 29.0, 9.2),
    "wide baseline, nearest": (
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        33.0,
        11.0,
    ),
    "little texture, warp2": (
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        1.8,
        0.81,
    ),
    "little texture, warp": (None, None, None, None, None, None, None, None, None, None, 2.0, 0.92),
    "little texture, blend": (
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        0.91,
        0.39,
    ),
    "little texture, nearest": (
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        1.5,
        0.61,
    ),
    "camera 30 Hz": (0.23, 0.84, 0.46, 0.35, None, None, None, 98, 42, 1.5),
    "camera 10 Hz": (0.4, 1.4, 0.38, 0.38, None, None, None, 98, 86, 1.7),
    "camera 15 Hz": (0.32, 1.2, 0.4, 0.38, None, None, None, 98, 70, 1.7),
    "camera 60 Hz": (0.19, 0.74, 0.57, 0.38, None, None, None, 98, 30, 1.5),
    "camera 120 Hz": (0.19, 0.79, 0.59, 0.43, None, None, None, 98, 27, 1.5),
    "camera 240 Hz": (0.18, 0.72, 0.62, 0.35, None, None, None, 98, 26, 1.2),
    "camera jitter of 4 ms": (0.25, 0.99, 0.48, 0.32, None, None, None, 98, 46, 1.7),
    "camera 30 % dropped": (0.28, 0.99, 0.45, 0.42, None, None, None, 98, 55, 1.7),
    "camera 10 % doubled": (0.29, 1.1, 0.57, 0.47, None, None, None, 98, 68, 1.5),
    "camera stamps of 5 ms noise": (0.26, 0.92, 0.55, 0.51, None, None, None, 98, 45, 1.5),
    "camera stamps 50 ms early": (0.33, 1.1, 0.48, 0.4, None, None, None, 98, 15, 1.7),
    "camera stamps 50 ms late": (0.28, 0.82, 0.46, 0.21, None, None, None, 98, 71, 1.5),
    "camera one stamp in 2 s 200 ms late": (0.43, 2.3, 0.84, 0.69, None, None, None, 98, 69, 1.5),
    "camera one stamp in 2 s 600 ms early": (0.26, 1.1, 0.41, 0.35, None, None, None, 98, 49, 1.5),
    "screen 60 Hz": (0.23, 0.84, 0.46, 0.35, None, None, None, 98, 42, 1.5),
    "screen 75 Hz": (0.26, 0.98, 0.38, 0.32, None, None, None, 98, 47, 1.4),
    "screen 120 Hz": (0.24, 0.92, 0.26, 0.23, None, None, None, 98, 44, 0.98),
    "screen 144 Hz": (0.25, 0.93, 0.23, 0.2, None, None, None, 98, 45, 0.74),
    "screen 59.94 Hz": (0.25, 0.92, 0.46, 0.36, None, None, None, 98, 45, 1.5),
    "screen 143.98 Hz": (0.24, 0.93, 0.23, 0.2, None, None, None, 98, 44, 0.65),
    "screen 60 Hz, busy machine": (0.29, 1.0, 0.94, 0.39, None, None, None, 98, 53, 3.4),
    "screen 60 Hz, delay of 0 ms": (0.057, 0.17, 0.42, 0.13, None, None, None, 98, 8, 1.4),
    "screen 60 Hz, delay of 40 ms": (0.13, 0.5, 0.45, 0.21, None, None, None, 98, 21, 1.5),
    "screen 60 Hz, delay of 120 ms": (0.35, 1.3, 0.5, 0.35, None, None, None, 98, 69, 1.7),
}


def judged(row: Row, of: str = "") -> Row:
    """The row with its figures compared with their bounds. of: what a row is, if no script."""
    limits = BOUNDS.get(f"{of} {row.name}" if of else row.name, ())
    bounds = {key: limit for key, limit in zip(FIGURES, limits, strict=False) if limit is not None}
    values = {
        key: _judged(value, bounds[key], key in LEAST) if key in bounds else value
        for key, value in row.values.items()
    }
    return attrs.evolve(row, values=values)


def _judged(value: Value, bound: float, least: bool) -> Value:
    if value.value >= bound if least else value.value <= bound:
        return attrs.evolve(value, state="ok")
    limit = "at least" if least else "at most"
    return attrs.evolve(
        value, state="failed", words=f"{short(value.value)}, {limit} {short(bound)} is right"
    )


def beyond(results: Results) -> list[str]:
    """A line for each figure beyond its bound, with script, figure and bound."""
    return [
        f"{row.name}: {column}: {value.text}"
        for _, row, column, value in results.judged()
        if value.state != "ok"
    ]
