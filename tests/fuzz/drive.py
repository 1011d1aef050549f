"""Drives the targets with mutated inputs: `python tests/fuzz/drive.py serial packet log --count 1000000`, or `--atheris` for coverage-guided.

The plain driver is seeded and needs nothing beside the project: inputs are mutations of the kept corpus (tests/fuzz/corpus/TARGET), or random
bytes. An input that breaks a target is written to the corpus, so that the tests replay it from then on.
"""

import argparse
import hashlib
import importlib
import random
import sys
import time
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.path[:0] = [str(FOLDER.parents[1]), str(FOLDER)]
CORPUS = FOLDER / "corpus"
INTERESTING = (b"\0", b"\xff", b"\x7f", b"\x80", b"\x04", b"\0\0\0\0", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x80\0\0\0", b"nan", b".inf",
               b"-", b":", b"{", b"[", b"\n", b"1e999", b"&a", b"*a", b"!!python/object:os.system ", b"\xf0\x9f\xa4\x96")  # fmt: skip
LONGEST = 1 << 16


def corpus(target: str) -> list[bytes]:
    """The kept inputs of a target."""
    return [path.read_bytes() for path in sorted((CORPUS / target).glob("*")) if path.is_file()]


def mutated(source: random.Random, kept: list[bytes]) -> bytes:
    """One input."""
    if not kept or source.random() < 0.1:
        return source.randbytes(source.choice((1, 8, 40, 200, 1000)))
    data = bytearray(source.choice(kept))
    for _ in range(source.choice((1, 1, 2, 4, 8))):
        at = source.randrange(len(data) + 1)
        kind = source.randrange(7)
        if kind == 0 and data:
            data[at - 1] ^= 1 << source.randrange(8)
        elif kind == 1 and data:
            data[at - 1] = source.randrange(256)
        elif kind == 2:
            data[at:at] = source.randbytes(source.randint(1, 16))
        elif kind == 3:
            del data[at : at + source.choice((1, 1, 2, 7, 32, 500))]
        elif kind == 4:
            data[at:at] = data[at : at + source.randint(1, 64)]
        elif kind == 5:
            value = source.choice(INTERESTING)
            data[at : at + len(value) * source.randrange(2)] = value
        else:
            other = source.choice(kept)
            data[at:] = other[source.randrange(len(other) + 1) :]
    return bytes(data[:LONGEST])


def drive(target: str, count: int, seed: int) -> int:
    """Runs `count` inputs through a target; returns the bytes that went in. Whatever the target raises goes on, its input is kept."""
    function = importlib.import_module("targets").TARGETS[target]
    source, kept, total = random.Random(f"{target} {seed}"), corpus(target), 0
    for _ in range(count):
        data = mutated(source, kept)
        try:
            function(data)
        except BaseException as error:
            if not isinstance(error, KeyboardInterrupt):
                place = CORPUS / target / f"broke-{hashlib.sha256(data).hexdigest()[:12]}"
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(data)
                print(f"{target}: input kept as {place}", file=sys.stderr)
            raise
        total += len(data)
    return total


def guided(target: str, arguments: list[str]) -> None:
    """Coverage-guided by atheris; its own options follow, such as -runs=100000."""
    import atheris

    with atheris.instrument_imports(include=["mip_rt"]):
        function = importlib.import_module("targets").TARGETS[target]
    (CORPUS / target).mkdir(parents=True, exist_ok=True)
    atheris.Setup([sys.argv[0], *arguments, str(CORPUS / target)], function)
    atheris.Fuzz()


def main() -> int:
    """Exit code 0; an input that breaks a target ends the program with its traceback."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", nargs="+", choices=("config", "scenario", "serial", "packet", "log", "sysfs_text"))
    parser.add_argument("--count", type=int, default=10000, help="inputs for each target (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--atheris", action="store_true", help="coverage-guided, one target; options of libFuzzer may follow, as -runs=10000")
    arguments, more = parser.parse_known_args()
    if arguments.atheris:
        guided(arguments.target[0], more)
        return 0
    if more:
        parser.error(f"unknown: {' '.join(more)}")
    for target in arguments.target:
        begin = time.monotonic()
        total = drive(target, arguments.count, arguments.seed)
        seconds = time.monotonic() - begin
        print(f"{target}: {arguments.count} inputs, {total} bytes, {seconds:.0f} s ({arguments.count / seconds:.0f} a second): nothing broke", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
