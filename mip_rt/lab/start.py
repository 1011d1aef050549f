"""What a start costs from the interpreter to the first tick, with compiled code kept: `python -m mip_rt.lab.start ours|plain|numba [--imports]`.

ours: as `mip-rt` does it. plain: the same modules as one would write them first: numba is imported, with what it brings along (scipy's linear
algebra), each compiled function is given to `numba.njit(cache=True)` where it stands, and what the loop calls is loaded from numba's own disk
cache for explicit signatures; the garbage collector is at work. numba: `import numba` alone. Devices, guard and recorder are not started.
`tools/test-armhf start` counts the instructions.
"""

import importlib
import sys
import time


def _modules():
    """(configuration, the robot's setup): everything that a session imports."""
    from mip_rt import config as configuration
    from mip_rt import robots
    from mip_rt import session  # noqa: F401

    config = configuration.load(configuration.default_path("mbbr"))
    return config, robots.setup(config.robot)


def ours() -> None:
    """Everything imported, the robot built, all that the loop calls ready."""
    from mip_rt import realtime

    realtime.quick_start()
    config, setup = _modules()
    from mip_rt.compiled import ENTRIES, direct
    from mip_rt.inputs import compile_for

    robot = setup.build(config)
    for function in ENTRIES:
        direct(function)
    compile_for(robot.layout.dtype)


def plain() -> None:
    """The same by numba's own means."""
    import scipy.linalg.cython_blas  # noqa: F401

    from mip_rt import compiled, machine_code

    numba = compiled.numba
    config, setup = _modules()
    for name, module in list(sys.modules.items()):
        if name.startswith("mip_rt."):
            for value in list(vars(module).values()):
                if isinstance(value, compiled.Function):
                    value.dispatcher  # noqa: B018  (made by the first look)
    machine_code.function = lambda *_: None  # ready machine code is not what is measured
    setup.build(config)
    for function, types in _called(compiled.ENTRIES, setup.FRAME):
        function.compile(tuple(_numba_type(numba, kind) for kind in types))


def _called(entries, frame_dtype):
    """(function, types of its arguments) of all that the loop calls."""
    from mip_rt import inputs
    from mip_rt.hardware import compiled_io

    yield from ((function, function.types) for function in entries)
    yield inputs.gather, inputs.gather_types(frame_dtype)
    yield compiled_io.write_pulses, compiled_io.write_types(frame_dtype)


def _numba_type(numba, kind):
    return getattr(numba.types, kind) if isinstance(kind, str) else numba.types.Array(numba.from_dtype(kind), 1, "C", aligned=True)


KINDS = {"ours": ours, "plain": plain, "numba": lambda: importlib.import_module("numba")}

if __name__ == "__main__":
    begin = time.perf_counter()
    KINDS[sys.argv[1]]()
    print(f"{sys.argv[1]}: {len(sys.modules)} modules, {time.perf_counter() - begin:.2f} s")
    if "--imports" in sys.argv:
        packages = {}
        for name in sys.modules:
            package = ".".join(name.split(".")[:2]) if name.startswith(("numba.", "mip_rt.")) else name.partition(".")[0]
            packages[package] = packages.get(package, 0) + 1
        print(", ".join(f"{name} {count}" for name, count in sorted(packages.items(), key=lambda item: -item[1])))
