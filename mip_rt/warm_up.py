"""The verb `mip-rt warm-up`: compile everything once and keep it, so that no later start compiles."""

import ast
import sys
import time
from pathlib import Path

from mip_rt.progress import progress


def add_arguments(parser) -> None:
    """None."""


def run(arguments) -> int:
    """Exit code 0."""
    begin = time.perf_counter()
    watch = _Watch()
    sys.meta_path.insert(0, watch)
    try:
        from mip_rt import inputs, robots

        for name in robots.NAMES:
            inputs.compile_for(robots.setup(name).FRAME)  # importing the setup compiles the step
    finally:
        sys.meta_path.remove(watch)
    progress(watch.total, watch.total, "")
    from mip_rt.compiled import CACHE_FOLDER

    print(f"compiled in {time.perf_counter() - begin:.1f} s, {f'kept in {CACHE_FOLDER}' if CACHE_FOLDER else 'but not kept'}")
    return 0


class _Watch:
    """Looks on while modules are imported, which is when most is compiled, and shows how far that is."""

    def __init__(self):
        self._wanted = reachable("mip_rt.robots.mbbr_setup", "mip_rt.robots.edumip_setup", "mip_rt.inputs", "mip_rt.hardware.compiled_io")
        self._done, self.total = 0, len(self._wanted)

    def find_spec(self, name, path, target=None):
        """Called before each import; finds nothing."""
        if name in self._wanted:
            self._wanted.discard(name)
            progress(self._done, self.total, name)
            self._done += 1


def reachable(*names: str) -> set[str]:
    """The modules of mip-rt that importing these imports, by their sources alone."""
    found, open_names = set(), list(names)
    while open_names:
        name = open_names.pop()
        parts = name.split(".")
        path = Path(__file__).parent.joinpath(*parts[1:]).with_suffix(".py")
        if name in found or parts[0] != "mip_rt" or not path.exists():
            continue
        found.add(name)
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ImportFrom) and node.module:
                open_names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return found
