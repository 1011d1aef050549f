"""The verb `mip-rt warm-up`: compile everything once and keep it, so that no later start compiles."""

import time

from mip_rt.progress import progress


def add_arguments(parser) -> None:
    """None."""


def run(arguments) -> int:
    """Exit code 0."""
    begin = time.perf_counter()
    from mip_rt import inputs, robots, session  # noqa: F401  (session imports every driver, and so marks what the loop calls)
    from mip_rt.compiled import CACHE_FOLDER, ENTRIES, direct

    frames = [robots.setup(name).FRAME for name in robots.NAMES]
    tasks = [(function.__name__, direct, function) for function in ENTRIES] + [("inputs", inputs.compile_for, frame) for frame in frames]
    for number, (name, task, argument) in enumerate(tasks):
        progress(number, len(tasks), name)
        task(argument)
    progress(len(tasks), len(tasks), "")
    print(f"compiled in {time.perf_counter() - begin:.1f} s, {f'kept in {CACHE_FOLDER}' if CACHE_FOLDER else 'but not kept'}")
    return 0
