"""What a start costs from the interpreter to the first tick, with compiled code kept: `python -m mip_rt.lab.start ours|plain|numba [--imports]`.

ours: as `mip-rt` does it. plain: the same modules, but with what numba brings along by itself (scipy's linear algebra) and the garbage
collector at work. numba: `import numba` alone. Devices, guard and recorder are not started. `tools/test-armhf start` counts the instructions.
"""

import importlib
import sys
import time


def loaded() -> None:
    """Everything that a session loads, the robot built, its step rehearsed, the compiled output ready."""
    from mip_rt import config as configuration
    from mip_rt import robots
    from mip_rt import session  # noqa: F401
    from mip_rt.inputs import compile_for

    config = configuration.load(configuration.default_path("mbbr"))
    robot = robots.setup(config.robot).build(config)
    compile_for(robot.layout.dtype)


def run(kind: str) -> None:
    """One of "ours", "plain", "numba"."""
    if kind == "ours":
        from mip_rt import realtime

        realtime.quick_start()
    elif kind == "plain":
        import scipy.linalg.cython_blas  # noqa: F401
    if kind == "numba":
        importlib.import_module(kind)  # without mip_rt.compiled, which everything else gets it from
    else:
        loaded()


if __name__ == "__main__":
    begin = time.perf_counter()
    run(sys.argv[1])
    print(f"{sys.argv[1]}: {len(sys.modules)} modules, {time.perf_counter() - begin:.2f} s")
    if "--imports" in sys.argv:
        packages = {}
        for name in sys.modules:
            package = ".".join(name.split(".")[:2]) if name.startswith(("numba.", "mip_rt.")) else name.partition(".")[0]
            packages[package] = packages.get(package, 0) + 1
        print(", ".join(f"{name} {count}" for name, count in sorted(packages.items(), key=lambda item: -item[1])))
