"""The verb `mip-rt warm-up`: compile everything once and keep it, so that no later start compiles."""

import sys
import time

from mip_rt.progress import progress


def add_arguments(parser) -> None:
    """None."""


def run(arguments) -> int:
    """Exit code 0."""
    begin = time.perf_counter()
    from mip_rt.compiled import CACHE_FOLDER, source_files

    watch = _Watch(len([file for file in source_files() if file.parent.name != "fake"]))
    sys.meta_path.insert(0, watch)
    try:
        from mip_rt import inputs, robots

        for name in robots.NAMES:
            inputs.compile_for(robots.setup(name).FRAME)  # importing the setup compiles the step
    finally:
        sys.meta_path.remove(watch)
    progress(watch.total, watch.total, "")
    print(f"compiled in {time.perf_counter() - begin:.1f} s, {f'kept in {CACHE_FOLDER}' if CACHE_FOLDER else 'but not kept'}")
    return 0


class _Watch:
    """Looks on while modules are imported, which is when most is compiled, and shows how far that is; a few of the total are of no robot."""

    def __init__(self, total: int):
        self._done, self.total = 0, total

    def find_spec(self, name, path, target=None):
        """Called before each import; finds nothing."""
        if name.startswith("mip_rt."):
            progress(min(self._done, self.total - 1), self.total, name)
            self._done += 1
