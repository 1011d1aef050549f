"""What a start must not cost."""

import subprocess
import sys


def test_a_start_does_not_load_scipys_linear_algebra_which_still_works_later():
    """numba looks for BLAS in scipy wherever that is installed: 0.2 s of every start, for nothing."""
    code = "import sys, mip_rt.session; assert 'scipy.linalg' not in sys.modules; import scipy.linalg.cython_blas"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
