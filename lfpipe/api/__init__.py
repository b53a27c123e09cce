"""What `import lfpipe` offers to programs and notebooks. `lfpipe/__init__.py` has the names; each is imported when it is used."""
