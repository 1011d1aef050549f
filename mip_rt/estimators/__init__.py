"""State estimators: compiled filters without I/O, clock or configuration files."""
