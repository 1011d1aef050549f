"""The person beside the robot: asked on the terminal, each time with a bound."""

import os
import select
import sys

from mip_rt.errors import MipRtError

PATIENCE_S = 300.0


class Person:
    """Questions on standard error, answers from standard input.

    Args:
        hands: callable(act): does in a dry run what the person is asked to do to the robot; None on a robot, where the person does it.
    """

    def __init__(self, hands=None):
        self._hands, self._typed = hands, b""

    def act(self, act: tuple) -> None:
        """What the person does to the robot now, for a dry run."""
        if self._hands is not None:
            self._hands(act)

    def _answer(self, text: str, hint: str) -> str:
        print(f"\n>> {text} {hint}", file=sys.stderr, end=" ", flush=True)
        # Past Python's own buffer, in which select would not see a second line that came with the first.
        while b"\n" not in self._typed:
            ready, _, _ = select.select([sys.stdin.fileno()], [], [], PATIENCE_S)
            data = os.read(sys.stdin.fileno(), 1024) if ready else b""
            if not data:
                raise MipRtError("nobody answered.", "Answer within five minutes, on a terminal.", "no_answer")
            self._typed += data
        line, _, self._typed = self._typed.partition(b"\n")
        return line.decode(errors="replace").strip()

    def do(self, text: str, act: tuple) -> None:
        """Asks for something to be done; returns when the person has pressed Enter."""
        self._answer(text, "Then press Enter.")
        self.act(act)

    def agrees(self, text: str) -> bool:
        """True only for a typed yes."""
        return self._answer(text, "[yes/no]").lower() == "yes"

    def chooses(self, text: str, choices, act: tuple | None = None) -> str:
        """One of the choices; asks up to three times."""
        for _ in range(3):
            answer = self._answer(text, f"[{'/'.join(choices)}]")
            if answer in choices:
                return answer
        raise MipRtError("none of the choices was answered.", f"Answer one of {', '.join(choices)}.", "no_answer")
