"""Drivers: the code that reaches the Linux kernel on the robot. Knows chips and files, no robot."""
