"""The verb `mip-rt warm-up`: compile everything once and keep it, so that no later start compiles."""

import time


def add_arguments(parser) -> None:
    """None."""


def run(arguments) -> int:
    """Exit code 0."""
    begin = time.perf_counter()
    from mip_rt import inputs, robots

    for name in robots.NAMES:
        inputs.compile_for(robots.setup(name).FRAME)  # importing the setup compiles the step

    print(f"compiled and kept in {time.perf_counter() - begin:.1f} s")
    return 0
