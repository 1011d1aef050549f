"""Names of the numbers and bits in a log's rows: those that the log carries, so that a log of another version keeps its own words."""

import numpy as np

from mip_rt import frame
from mip_rt.faults import FAULT_BY_NUMBER, FAULTS
from mip_rt.hardware import imu_status
from mip_rt.prearm import CHECKS
from mip_rt.supervisor import State

# Bits by name in this program. Of the IMU's status the good packet is no event.
BITS = {
    "limits": frame.LIMITS,
    "alarms": frame.ALARMS,
    "refusals": {name: check.bit for name, check in CHECKS.items()},
    "imu_status": {name[4:].lower(): bit for name, bit in vars(imu_status).items() if name.startswith("IMU_") and bit != imu_status.IMU_OK},
}


class Codes:
    """The names in one log.

    Args:
        header: of the log; where it has no `codes`, this program's names are used.

    Attributes:
        fault_state: number of the state FAULT.
        balancing_state: number of the state BALANCING.
    """

    def __init__(self, header: dict):
        found = header.get("codes", {})
        self._states = {int(n): name for n, name in found.get("state", {}).items()} or {int(s): s.name for s in State}
        self._faults = {int(n): code for n, code in found.get("fault", {}).items()} or {n: f.code for n, f in FAULT_BY_NUMBER.items()}
        self._bits = {field: {name: int(bit) for bit, name in found.get(field, {}).items()} or known for field, known in BITS.items()}
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

    def bits_in(self, field: str, words) -> dict[str, int]:
        """Bit by name of a field of bits (`BITS`); and the bits without a name that occur in these words, called "bit N"."""
        known = self._bits[field]
        used = int(np.bitwise_or.reduce(words)) if len(words) else 0
        unnamed = used & ~sum(known.values()) & ~(imu_status.IMU_OK if field == "imu_status" else 0)
        return known | {f"bit {bit}": 1 << bit for bit in range(63) if unnamed >> bit & 1}

    def limits_in(self, words) -> dict[str, int]:
        """Likewise of frame.limits."""
        return self.bits_in("limits", words)
