"""The verb `mip-rt calibrate`."""

import importlib
import json

from mip_rt.doctor import open_patient

WHAT = ("gyro", "level", "accelerometer", "encoders", "motors")


def add_arguments(parser) -> None:
    """Declares the verb's arguments."""
    parser.add_argument("what", choices=(*WHAT, "show"), help="what to measure; or show the file")
    open_patient.add_arguments(parser)
    parser.add_argument("--unit", metavar="NAME", help="name of this robot in the file")
    parser.add_argument("--json", action="store_true", help="the file's content as JSON")


def run(arguments) -> int:
    """Exit code 0.

    Raises:
        MipRtError: the data are bad (nothing is stored), or a device refuses.
    """
    from mip_rt import unit_file

    with open_patient.open_patient(arguments, True) as patient:
        path = unit_file.unit_path(patient.config, patient.kernel)
        if arguments.what == "show":
            unit = unit_file.load_unit_file(path)
            print(json.dumps(unit.content() if unit else {}, indent=1))
            return 0
        unit, words = calibrate(patient, arguments.what, arguments.unit)
        where = "a dry run keeps nothing" if arguments.dry_run else f"kept in {path}; runs from now on use it"
        print(json.dumps(unit.content()) if arguments.json else f"{arguments.what}: {words}\n{where}")
    return 0


def calibrate(patient, what: str, name: str | None = None):
    """(UnitFile, words): measures one thing and stores it.

    Raises:
        MipRtError: it is refused; the file is then unchanged.
    """
    from mip_rt import unit_file
    from mip_rt.doctor import services
    from mip_rt.doctor.report import FAIL
    from mip_rt.errors import MipRtError
    from mip_rt.hardware.boards import board

    for check in services.examine(patient):
        if check.verdict == FAIL:
            raise MipRtError(check.sentence, check.cure, "calibrate_busy")
    patient.pins = board(patient.config.board, patient.kernel)
    path = unit_file.unit_path(patient.config, patient.kernel)
    unit_file.load_unit_file(path)  # a broken one is refused before anyone does any work
    if what == "motors":
        patient.config, _ = unit_file.apply_unit_file(patient.config, patient.kernel)  # the encoders' signs, if they are known
    module = importlib.import_module(f"mip_rt.calibrate.{what}")
    found = module.measure(patient)
    return unit_file.store(path, name, what, found), module.in_words(found)
