"""The schema of every robot by its name."""

from mip_rt.config.schema import MBBR
from mip_rt.config.schema_edumip import EDUMIP

ROBOTS = {"mbbr": MBBR, "edumip": EDUMIP}
