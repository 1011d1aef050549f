"""Names of the numbers and bits in a log's rows: those that the log carries, so that a log of another version keeps its own words."""

import numpy as np

from mip_rt.frame import LIMITS
from mip_rt.hardware import imu_status
from mip_rt.supervisor import FAULT_BY_NUMBER, FAULTS, State

IMU = {name[4:].lower(): bit for name, bit in vars(imu_status).items() if name.startswith("IMU_") and bit != imu_status.IMU_OK}


class Codes:
    """The names in one log.

    Args:
        header: of the log; where it has no `codes`, this program's names are used.

    Attributes:
        limits: bit by name, of frame.limits; bits that have no name are called "bit N".
        imu: bit by name, of frame.imu_status, without the good packet's.
        fault_state: number of the state FAULT.
        balancing_state: number of the state BALANCING.
    """

    def __init__(self, header: dict):
        found = header.get("codes", {})
        self._states = {int(n): name for n, name in found.get("state", {}).items()} or {int(s): s.name for s in State}
        self._faults = {int(n): code for n, code in found.get("fault", {}).items()} or {n: f.code for n, f in FAULT_BY_NUMBER.items()}
        self.limits = {name: int(bit) for bit, name in found.get("limits", {}).items()} or dict(LIMITS)
        self.imu = dict(IMU)
        numbers = {name: number for number, name in self._states.items()}
        self.fault_state = numbers.get("FAULT", int(State.FAULT))
        self.balancing_state = numbers.get("BALANCING", int(State.BALANCING))

    def state(self, number) -> str:
        """Name of a supervisor state."""
        return self._states.get(int(number), f"state {int(number)}")

    def fault(self, number) -> str:
        """Code of a fault."""
        return self._faults.get(int(number), f"fault {int(number)}")

    def fault_words(self, number) -> dict:
        """Code, sentence and cure of a fault."""
        code = self.fault(number)
        known = FAULTS.get(code)
        sentence, cure = (known.sentence, known.cure) if known else ("this version of mip-rt does not know it", "")
        return {"code": code, "sentence": sentence, "cure": cure}

    def limits_in(self, words) -> dict[str, int]:
        """`limits`, and the bits without a name that occur in these words."""
        unnamed = int(np.bitwise_or.reduce(words)) & ~sum(self.limits.values()) if len(words) else 0
        return self.limits | {f"bit {bit}": 1 << bit for bit in range(63) if unnamed >> bit & 1}
