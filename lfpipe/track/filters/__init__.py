"""Filters of the eye positions: one module each, and the parts of the default one (`imm`)."""
