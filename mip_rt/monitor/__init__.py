"""Watching a running loop from another process, through the ring that it writes anyway: terminal, JSON lines, web page."""
