"""The kernel boundary on a PC: chips, sysfs, lines and a world that moves them. Only `cli` and tests import it."""
