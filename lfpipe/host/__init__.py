"""Everything that differs between operating systems, behind plain functions."""
