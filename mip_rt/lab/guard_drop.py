"""How fast the enable line falls when the control loop ends badly: real dry runs in real time, watched by another process.

The victim is a whole dry run in a process of its own, with its guard. The observer waits until it balances, then kills it, stops it, makes it spin,
or kills its guard, and reads the enable line as the motor drivers do, until it is low. A stopped or spinning victim goes on afterwards,
must then be in FAULT, and is armed again by the whole gesture for the next run.
"""

import json
import os
import random
import select
import signal
import subprocess
import sys
import time

from mip_rt import realtime

BOUND_S = 0.1
KINDS = {  # what happens: words for the table
    "kill": "control process killed (SIGKILL)",
    "stop": "control process stopped (SIGSTOP)",
    "hang": "control loop spins (busy loop)",
    "guard": "guard killed (SIGKILL)",
    "guard_fault": "guard killed: loop in FAULT, duty 0",
}
SPIN_S = 0.15
OBSERVER_PRIORITY = 60
LIMIT_S = 30.0


# -- the victim ------------------------------------------------------------------------------------------------------
class Victim:
    """Called after each tick in the place of a status line: tells the observer what happens, spins when that is its kind, arms again."""

    def __init__(self, bench, spins: bool):
        self._bench, self._spins = bench, spins
        self._told = self._wait = 0

    def update(self, session) -> None:
        """One tick."""
        from mip_rt.supervisor import State

        state = session.supervisor.state
        self._wait -= 1
        if state is State.BALANCING and session.supervisor.drive_scale >= 1.0:
            if not self._told:
                self._told, self._wait = 1, 40
                tell("balancing")
            elif self._spins and self._wait == 0:
                begin = time.monotonic_ns()
                tell(f"hang {begin}")
                while time.monotonic_ns() - begin < SPIN_S * 1e9:
                    pass
        elif state is State.FAULT and self._told:
            self._told, self._wait = 0, 0
            tell(f"fault {session.supervisor.fault.code} {time.monotonic_ns()}")
        elif state in (State.FAULT, State.DISARMED) and self._wait <= 0:
            self._wait = 20
            kernel = self._bench.kernel
            kernel.operator.press_arm(kernel.monotonic_ns())


def tell(text: str) -> None:
    """One line to the observer."""
    os.write(1, f"{text}\n".encode())


def victim(kind: str) -> None:
    """A dry run without end that does what its kind wants."""
    import tempfile
    from pathlib import Path

    from mip_rt import config as configuration
    from mip_rt import guard_client
    from mip_rt.config.scenario import Scenario
    from mip_rt.fake.machine import Machine

    realtime.leave()  # a child inherits the observer's priority
    config = configuration.load(configuration.default_path("mbbr"), {"estimator.shadows": "[]", "log.ring_s": "5"})
    machine = Machine(config)
    guard = guard_client.start(config, machine)
    tell(f"root {machine.folder} {guard.pid}")

    from mip_rt import session as runner
    from mip_rt.fake import bench as fake_bench

    bench = fake_bench.build(config, Scenario("guard", "", 1e6, []), 1, True, machine, guard)
    try:
        with tempfile.TemporaryDirectory() as folder:
            session = runner.Session(config, bench, Path(folder), bench.remote.device, 1, "guard")
            session.run(1e6, runner.install_signals(), Victim(bench, kind == "hang"))
    finally:
        bench.close()


# -- the observer ----------------------------------------------------------------------------------------------------
class Observed:
    """A running victim, as another process sees it."""

    def __init__(self, kind: str):
        from mip_rt.fake.gpio import FakeGpio
        from mip_rt.hardware.boards import BOARDS, GPIO

        self.process = subprocess.Popen([sys.executable, "-m", "mip_rt.lab.guard_drop", kind], stdout=subprocess.PIPE, bufsize=0)
        self._rest, self._poll = b"", select.poll()
        self._poll.register(self.process.stdout, select.POLLIN)
        self.root, guard = self.told("root")
        self.guard = int(guard)
        bank, self._offset = BOARDS["beaglebone-black-cape"].enable
        self._bank = FakeGpio(self.root).bank(GPIO[bank])

    def told(self, word: str) -> list[str]:
        """Waits for a line that begins with this word; what follows it.

        Raises:
            RuntimeError: the victim ended, or said nothing of the kind.
        """
        deadline = time.monotonic() + LIMIT_S
        while time.monotonic() < deadline:
            line, newline, rest = self._rest.partition(b"\n")
            if newline:
                self._rest = rest
                first, *words = line.decode().split()
                if first == word:
                    return words
                continue
            if self._poll.poll(200):
                data = os.read(self.process.stdout.fileno(), 4096)
                if not data:
                    break
                self._rest += data
        raise RuntimeError(f"the dry run never said {word!r}")

    def seconds_until_low(self, since_ns: int) -> float:
        """Looks at the enable line until it is low.

        Raises:
            RuntimeError: it stays high for a second.
        """
        while self._bank.level(self._offset):
            time.sleep(1e-4)
            if time.monotonic_ns() - since_ns > 1e9:
                raise RuntimeError("the enable line stays high")
        return (time.monotonic_ns() - since_ns) * 1e-9

    def level(self) -> int:
        """Of the enable line."""
        return self._bank.level(self._offset)

    def end(self) -> None:
        """Ends the victim and removes its folder."""
        import shutil

        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        shutil.rmtree(self.root, ignore_errors=True)


def fall(observed: Observed, kind: str, delay_s: float) -> dict:
    """One run of a kind on a victim: {kind: seconds until the line was low}; the victim goes on where it can."""
    observed.told("balancing")
    if not observed.level():
        raise RuntimeError("the dry run balances, but its enable line is low")
    time.sleep(delay_s)
    found = {}
    if kind == "hang":
        begin = int(observed.told("hang")[0])
    else:
        begin = time.monotonic_ns()
        os.kill(observed.guard if kind == "guard" else observed.process.pid, signal.SIGSTOP if kind == "stop" else signal.SIGKILL)
    found[kind] = observed.seconds_until_low(begin)
    if kind == "stop":
        time.sleep(0.05)
        observed.process.send_signal(signal.SIGCONT)
    if kind != "kill":
        code, when = observed.told("fault")
        wanted = "guard_lost" if kind == "guard" else "guard_dropped"
        if code != wanted:
            raise RuntimeError(f"expected the fault {wanted}, found {code}")
        if kind == "guard":
            found["guard_fault"] = (int(when) - begin) * 1e-9
    return found


def measure(runs: int, progress) -> dict:
    """{kind: list of seconds}; `runs` of each kind, at random moments within the tick."""
    scheduling = realtime.enter("fifo", OBSERVER_PRIORITY, False)
    if scheduling.policy != "fifo":
        print("warning: the observer runs without SCHED_FIFO, its times are upper bounds", file=sys.stderr)
    source, found = random.Random(1), {kind: [] for kind in KINDS}
    try:
        for number, kind in enumerate(("kill", "stop", "hang", "guard")):
            once = kind in ("kill", "guard")  # these end the victim: the next one starts while the present one is watched
            victims = [Observed(kind)]
            try:
                for run in range(runs):
                    progress(number * runs + run, 4 * runs, KINDS[kind])
                    if once and run + 1 < runs:
                        victims.append(Observed(kind))
                    for name, seconds in fall(victims[0], kind, source.uniform(0.01, 0.02)).items():
                        found[name].append(seconds)
                    if once:
                        victims.pop(0).end()
            finally:
                for observed in victims:
                    observed.end()
        progress(1, 1, "")
    finally:
        realtime.leave()
    return found


def report(found: dict, as_json: bool) -> int:
    """Prints the table; exit code 1 where the bound is broken."""
    rows = {
        kind: {"runs": len(times), "median_s": sorted(times)[len(times) // 2], "worst_s": max(times), "bound_s": BOUND_S}
        for kind, times in found.items()
    }
    if as_json:
        print(json.dumps(rows))
    else:
        print("| what happens | runs | median | worst | bound |\n|---|---|---|---|---|")
        for kind, row in rows.items():
            print(f"| {KINDS[kind]} | {row['runs']} | {row['median_s'] * 1e3:.1f} ms | {row['worst_s'] * 1e3:.1f} ms | {BOUND_S * 1e3:.0f} ms |")
    return int(any(row["worst_s"] > BOUND_S for row in rows.values()))


if __name__ == "__main__":
    victim(sys.argv[1])
