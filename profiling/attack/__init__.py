"""Hostile input against the real program: commands over ctl, the page, files of every kind, odd paths.

uv run python -m profiling.attack [--quick] [--seed N] [--out profiling/results/attack.md]
"""
