"""Bring-ups with a fault at a random transfer; `mip-rt bench bring-up` does a thousand."""

import errno
import random

import pytest

from mip_rt.hardware.bus_errors import BUS_ERRORS, explain
from mip_rt.lab import bring_up


def test_every_bring_up_ends_with_a_named_step_and_a_clean_retry():
    """Never a hang, never an armed motor, never a start that says well while the DMP does not run."""
    results = bring_up.run(100)
    assert [(result["seed"], result["broken"]) for result in results if result["broken"]] == []
    assert sum(result["outcome"] != "well" for result in results) > 20 and max(result["seconds"] for result in results) < bring_up.BOUND_S


def test_the_campaign_notices_what_it_looks_for(monkeypatch):
    """A driver that fails without a step, and one that keeps a line, are found."""
    from mip_rt.hardware.mpu9250 import Mpu9250

    seed = next(seed for seed in range(1, 50) if (t := bring_up.Trouble(random.Random(seed), None)).kind == "error" and t.length > 5)
    monkeypatch.setattr(Mpu9250, "_step", lambda self, name, action: action())
    assert "OSError" in bring_up.one(seed)["broken"][0]


@pytest.mark.parametrize("number", [errno.ETIMEDOUT, errno.EREMOTEIO, errno.EIO, errno.EAGAIN, errno.EBUSY])
def test_every_error_number_of_the_bus_has_words_and_a_cure(number):
    words, cure = explain(OSError(number, "x"))
    assert number in BUS_ERRORS and str(number) in words and len(words) > 20 and cure.endswith(".")
    assert explain(OSError(99, "x"))[1]
