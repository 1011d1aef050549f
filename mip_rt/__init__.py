"""mip-rt: a real-time controller for balancing robots on BeagleBone Black and Blue."""

__version__ = "0.1.0"
