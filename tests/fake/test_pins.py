"""Wires of the dry run: what the mapped files show and what is read from them."""

import numpy as np
import pytest

from mip_rt.fake import pins
from mip_rt.fake.sysfs import MappedFile

EDGES = (0, 1, -1, 9, 10, -10, 99999, -99999, 2**31 - 1, 2**31, -(2**31), 2**32 - 1, 2**32, 2**33 + 5, -(2**33) - 5)


@pytest.mark.parametrize("signed", (0, 1))
def test_a_counters_file_holds_exactly_its_number(tmp_path, signed):
    """Left-over digits of a longer number, a wrong wrap or a missing minus sign would reach the driver as a jump."""
    files = [MappedFile(tmp_path / str(wheel), b"0\n") for wheel in range(2)]
    wires = pins.records()
    p = wires[0]
    p["wheels"], p["signed"] = 2, signed
    p["count_at"][:2], p["count_fd"][:2] = [file.address for file in files], [file.fd for file in files]
    for count in EDGES:
        pins.show_counts(wires, np.array([count, -count], np.int64))
        for file, wanted in zip(files, (count, -count)):
            shown = wanted % (1 << 32)
            if signed and shown >= 1 << 31:
                shown -= 1 << 32
            assert file.path.read_bytes() == b"%d\n" % shown
    for file in files:
        file.close()
