"""What a start must not cost."""

import subprocess
import sys


def test_a_start_does_not_load_scipys_linear_algebra_which_still_works_later():
    """numba looks for BLAS in scipy wherever that is installed: 0.2 s of every start, for nothing."""
    code = "import sys, mip_rt.session; assert 'scipy.linalg' not in sys.modules; import scipy.linalg.cython_blas"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_warm_up_knows_how_much_there_is_to_do():
    """Prevents a bar that never fills or runs over: what it expects by the sources is what is imported."""
    code = """
import sys
from mip_rt import warm_up
names = [f"mip_rt.robots.{name}_setup" for name in ("mbbr", "edumip")] + ["mip_rt.hardware.compiled_io"]
expected = warm_up.reachable(*names)
for name in names:
    __import__(name)
loaded = {name for name in sys.modules if name.startswith("mip_rt.") and not hasattr(sys.modules[name], "__path__")}
assert expected <= loaded, expected - loaded
assert {name for name in loaded if name.split(".")[1] in ("models", "estimators", "controllers", "robots")} <= expected, loaded - expected
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)
