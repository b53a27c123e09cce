"""The interface of `import lfpipe` for programs and notebooks. `lfpipe/__init__.py` lists the names
and imports each on first use.
"""
