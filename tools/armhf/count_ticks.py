"""The program whose instructions tools/test-armhf counts: `count_ticks.py ekf|momentum|tick|PART|choices-ROBOT N`.

ekf, momentum: N steps of that compiled filter alone; tick: N whole ticks of the control loop; PART: see mip_rt.lab.costs. The cost of one is the
difference of two counted runs with different N, divided by the difference of N: start-up and compilation cancel out. choices-ROBOT: see
mip_rt.lab.choices, which marks its parts itself.
"""

import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))
from mip_rt.lab import choices, costs  # noqa: E402

if __name__ == "__main__":
    kind, count = sys.argv[1], int(sys.argv[2])
    choices.count(kind.removeprefix("choices-"), count) if kind.startswith("choices-") else costs.run(kind, count)
