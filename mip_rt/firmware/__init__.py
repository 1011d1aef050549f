"""What the robot needs outside of Python: device-tree overlay, U-Boot's configuration, udev rules, modprobe configuration; applied and taken back."""
