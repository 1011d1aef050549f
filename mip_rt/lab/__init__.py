"""Experiments, comparisons and measurements; nothing that the robot needs."""
