"""The examination: the layers in their order, each only where what it stands on is sound."""

import importlib
from typing import NamedTuple

from mip_rt.doctor.report import FAIL, SKIP, Report, fail, skip
from mip_rt.errors import MipRtError


class Layer(NamedTuple):
    """One layer: module mip_rt.doctor.NAME with `examine(patient)` yielding Checks, and the lines ("layer.check") that must not have failed before."""

    name: str
    needs: tuple = ()


# `services` first: a robot that runs must not be disturbed. `software` early: encoders and motors need the compiler, and where LLVM aborts, it must be
# a child process that dies.
LAYERS = (
    Layer("services"),
    Layer("software"),
    Layer("board"),
    Layer("i2c", ("services.mip-rt", "board.model")),
    Layer("imu", ("services.mip-rt", "board.model", "i2c.device", "i2c.driver", "i2c.answer")),
    Layer("encoders", ("services.mip-rt", "software.compiler", "board.model")),
    Layer("motors", ("services.mip-rt", "software.compiler", "board.model")),
    Layer("power", ("services.mip-rt", "board.model")),
    Layer("remote", ("services.mip-rt",)),
    Layer("realtime"),
)


def _in_the_way(report: Report, layer: Layer) -> str:
    for need in layer.needs:
        name, _, check = need.partition(".")
        found = report.find(name, check)
        if found is not None and found.verdict in (FAIL, SKIP):
            return need
    return ""


def examine(patient, layers=LAYERS, tell=None) -> Report:
    """Looks at all layers; never raises for what it finds.

    Args:
        tell: callable(layer, check), called as each line is found.
    """
    report = Report()

    def note(layer, check):
        report.add(layer, check)
        if tell is not None:
            tell(layer, check)

    for layer in layers:
        need = _in_the_way(report, layer)
        if need:
            note(layer.name, skip("all", f"{need} failed"))
            continue
        try:
            for check in importlib.import_module(f"mip_rt.doctor.{layer.name}").examine(patient):
                note(layer.name, check)
        except MipRtError as error:
            note(layer.name, fail(error.code, error.sentence, error.cure))
        except (OSError, ValueError) as error:
            note(layer.name, fail("unexpected", f"{type(error).__name__}: {error}.", "Send the developers what `mip-rt doctor --bundle FILE` writes."))
    return report
