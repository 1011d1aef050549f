"""Which known word did the user mean?"""

import difflib


def nearest(word, known) -> str:
    """"; did you mean 'x'?" for the nearest known word, or nothing."""
    matches = difflib.get_close_matches(str(word), list(known), n=1, cutoff=0.5)
    return f"; did you mean {matches[0]!r}?" if matches else ""
