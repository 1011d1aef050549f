"""What a robot is: its model, estimators, controller and compiled step."""

import importlib

NAMES = ("mbbr", "edumip")


def setup(name: str):
    """The module that builds the robot of this name: `build(config)`, `Judge(config)` and `FRAME`; imported only now."""
    return importlib.import_module(f"mip_rt.robots.{name}_setup")


def layout(name: str):
    """The frame.Layout of the robot of this name; compiles nothing."""
    return importlib.import_module(f"mip_rt.robots.{name}_frame").LAYOUT
