"""Sends eyes, head and shown pictures to other programs. Runs only while a session shares."""
