"""The verb `mip-rt doctor`."""

import json
import sys
from pathlib import Path

from mip_rt.doctor import open_patient
from mip_rt.errors import MipRtError


def add_arguments(parser) -> None:
    """Declares the verb's arguments."""
    open_patient.add_arguments(parser)
    parser.add_argument("--interactive", action="store_true", help="also what needs a person: turning wheels by hand, motors off the ground, the remote")
    parser.add_argument("--json", action="store_true", help="the report as one JSON object")
    parser.add_argument("--bundle", metavar="FILE", type=Path, help="also write a file for support (tar.gz, redacted)")


def run(arguments) -> int:
    """Exit code 0 where nothing failed, 1 otherwise."""
    from mip_rt.doctor import examination, report

    if "list" in arguments.fault:
        print(open_patient.faults_in_words())
        return 0
    tell = None if arguments.json else lambda layer, check: print(report.render(layer, check), flush=True)
    with open_patient.open_patient(arguments, arguments.interactive) as patient:
        found = examination.examine(patient, tell=tell)
        if arguments.json:
            print(json.dumps(found.as_dict()))
        else:
            print(f"\n{report.verdict_in_words(found)}")
        if arguments.bundle:
            from mip_rt.doctor import bundle

            try:
                size = bundle.write(arguments.bundle, found, patient)
            except OSError as error:
                raise MipRtError(f"{arguments.bundle} cannot be written: {error.strerror}.", "Name another file.", "bundle_write") from error
            print(f"{arguments.bundle}: {size / 1e3:.0f} kB; read it before you send it: names, addresses and serial numbers are taken out by rule.", file=sys.stderr)
    return int(found.count(report.FAIL) > 0)
