"""Eyes, head and pictures shown, sent to other programs. Runs only while a session is asked to share."""
