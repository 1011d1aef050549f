"""The program whose instructions tools/test-armhf counts: `count_ticks.py step N` or `count_ticks.py tick N`.

step: N steps of the compiled extended Kalman filter alone; tick: N whole ticks of the control loop. The cost of one is the
difference of two counted runs with different N, divided by the difference of N: start-up and compilation cancel out.
"""

import sys

from mip_rt.lab import costs

if __name__ == "__main__":
    costs.run(sys.argv[1], int(sys.argv[2]))
