"""What all tests share: hypothesis profiles and the versions that a test report must name."""

import importlib.metadata
import os
import platform
import resource
import shutil
from pathlib import Path

import numpy
import pytest
from hypothesis import HealthCheck, settings

# The first call of a compiled function takes seconds, so no deadline. CI must not depend on luck, so it draws the same examples.
settings.register_profile("host", deadline=None, derandomize="CI" in os.environ)
# tools/test-armhf: emulation is about 20 times slower.
settings.register_profile(
    "emulated", deadline=None, derandomize=True, max_examples=10, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("host")

# Drivers in the tests keep their descriptors until the garbage collector comes by; many systems allow 1024.
resource.setrlimit(resource.RLIMIT_NOFILE, (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)


def pytest_report_header() -> str:
    names = ("numba", "numpy", "smbus2", "PyYAML", "pyserial")
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names)
    compiled = "not compiled" if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0") else "compiled"
    return f"{platform.machine()}, {versions}, {compiled}"


def pytest_collection_modifyitems(items):
    """What `robot_packages` marks is run once in .ci/run, with the packages that it is about."""
    system = Path("/etc/os-release")
    debian_12 = system.exists() and {"ID=debian", 'VERSION_ID="12"'} <= set(system.read_text().split())
    if debian_12 and not numpy.__file__.startswith("/usr/lib/python3/"):
        for item in items:
            if item.get_closest_marker("robot_packages"):
                item.add_marker(pytest.mark.skip(reason="about the robot's packages: tools/test --debian runs it"))


@pytest.fixture(autouse=True)
def closed_boards():
    """Closes what `board.Kernel` has opened."""
    import board

    yield
    board.Kernel.close_all()


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    report = (yield).get_result()
    if call.when == "call":
        item.passed = report.passed


@pytest.fixture(autouse=True)
def folder_of_a_passed_test_is_removed(request):
    """Rings and recordings of a whole run of the tests would be 13 GB."""
    yield
    folder = request.node.funcargs.get("tmp_path")
    if folder is not None and getattr(request.node, "passed", False):
        shutil.rmtree(folder, ignore_errors=True)
