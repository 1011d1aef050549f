"""Controllers and their parts: compiled, without I/O, clock or configuration files."""
