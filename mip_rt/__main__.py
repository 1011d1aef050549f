"""`python -m mip_rt`."""

import sys

from mip_rt.cli import main

sys.exit(main())
