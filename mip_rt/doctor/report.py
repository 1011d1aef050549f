"""What doctor found, as data: one Check a line, in layers."""

from typing import NamedTuple

PASS, WARN, FAIL, SKIP = "pass", "warn", "fail", "not checked"
SIGNS = {PASS: "ok  ", WARN: "warn", FAIL: "FAIL", SKIP: "-   "}


class Check(NamedTuple):
    """One line.

    Attributes:
        name: stable, lower case, unique within its layer.
        verdict: PASS, WARN, FAIL or SKIP.
        sentence: what was found, with the figures.
        cure: what to do, where it did not pass.
    """

    name: str
    verdict: str
    sentence: str
    cure: str = ""


def ok(name: str, sentence: str) -> Check:
    """It is as it should be."""
    return Check(name, PASS, sentence)


def warn(name: str, sentence: str, cure: str) -> Check:
    """The robot works, but not as well as it could."""
    return Check(name, WARN, sentence, cure)


def fail(name: str, sentence: str, cure: str) -> Check:
    """The robot cannot balance like this."""
    return Check(name, FAIL, sentence, cure)


def skip(name: str, because: str, cure: str = "") -> Check:
    """It could not be looked at."""
    return Check(name, SKIP, f"not checked because {because}", cure)


class Report:
    """All lines.

    Attributes:
        layers: {layer: list of Check}, in the order of looking.
    """

    def __init__(self):
        self.layers = {}

    def add(self, layer: str, check: Check) -> None:
        """Appends a line."""
        self.layers.setdefault(layer, []).append(check)

    def find(self, layer: str, name: str) -> Check | None:
        """The line of this name; None where there is none."""
        return next((check for check in self.layers.get(layer, ()) if check.name == name), None)

    def count(self, verdict: str) -> int:
        """How many lines have this verdict."""
        return sum(check.verdict == verdict for checks in self.layers.values() for check in checks)

    def as_dict(self) -> dict:
        """For --json."""
        return {
            "counts": {verdict: self.count(verdict) for verdict in (PASS, WARN, FAIL, SKIP)},
            "checks": [{"layer": layer, **check._asdict()} for layer, checks in self.layers.items() for check in checks],
        }


def render(layer: str, check: Check) -> str:
    """One line, or two with the cure."""
    line = f"{SIGNS[check.verdict]} {layer + '.' + check.name:<24} {check.sentence}"
    return line + (f"\n{'':<30}cure: {check.cure}" if check.cure else "")


def verdict_in_words(report: Report) -> str:
    """The last line."""
    counts = ", ".join(f"{report.count(verdict)} {verdict}" for verdict in (PASS, WARN, FAIL, SKIP))
    if report.count(FAIL):
        layer, check = next((layer, check) for layer, checks in report.layers.items() for check in checks if check.verdict == FAIL)
        return f"{counts}. Begin with {layer}.{check.name}: {check.cure}"
    return f"{counts}. " + ("What was checked is in order." if not report.count(WARN) else "Nothing forbids to balance; see the warnings.")
