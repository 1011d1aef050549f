"""The experiments of five papers, one module a paper or chapter; `mip-rt reproduce` runs them."""

import importlib

MODULES = (
    "acc2018",
    "parameters",
    "dissertation_geometry",
    "dissertation_motor",
    "dissertation_bridge",
    "dissertation_friction",
    "dissertation_simulation",
    "dissertation_compensation",
    "dissertation_table61",
    "dissertation_causes",
    "dissertation_spin",
    "dissertation_driving",
    "omurchadha",
    "omurchadha_position",
    "aoyagi_choi",
    "lee_jung",
)


def experiments() -> dict:
    """{name: Experiment} of every module, in the order of the papers."""
    found = {}
    for module in MODULES:
        for experiment in importlib.import_module(f"{__name__}.{module}").EXPERIMENTS:
            assert experiment.name not in found, experiment.name
            found[experiment.name] = experiment
    return found
