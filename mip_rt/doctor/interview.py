"""The person beside the robot: asked on the terminal, each time with a bound."""

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
        self._hands = hands

    def act(self, act: tuple) -> None:
        """What the person does to the robot now, for a dry run."""
        if self._hands is not None:
            self._hands(act)

    def _answer(self, text: str, hint: str) -> str:
        print(f"\n>> {text} {hint}", file=sys.stderr, end=" ", flush=True)
        ready, _, _ = select.select([sys.stdin], [], [], PATIENCE_S)
        line = sys.stdin.readline() if ready else ""
        if not line:
            raise MipRtError("nobody answered.", "Answer within five minutes, on a terminal.", "no_answer")
        return line.strip()

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
