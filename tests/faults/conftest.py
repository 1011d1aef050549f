"""A robot that balances on fakes, on virtual time, for tests that then break something."""

import pytest
from helpers import DryRun

from mip_rt.supervisor import State


@pytest.fixture
def balancing(tmp_path):
    with DryRun(tmp_path) as dry:
        dry.until(lambda: dry.state is State.BALANCING)
        dry.until(lambda: dry.motors_on(), 1.0)
        yield dry
