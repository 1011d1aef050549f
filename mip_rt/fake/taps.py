"""Filters on the calls that reach a fake: put in front of a method while a fault lasts, gone without a trace afterwards.

Without filters the method is the class's own, so a dry run without faults costs nothing more.
"""


class Taps:
    """Filters by object and method; the newest is asked first, but those that watch from outside always before it.

    Attributes:
        changes: how often one was added or taken away.
    """

    def __init__(self):
        self._chains = {}
        self.changes = 0

    def add(self, target, name: str, filter_, outside: bool = False):
        """Puts `filter_(call, *arguments)` in front of target.name; returns a function that takes it away."""
        key = (id(target), name)
        if key not in self._chains:
            self._chains[key] = (getattr(target, name), name in vars(target), [], [])
        filters = self._chains[key][3 if outside else 2]
        filters.append(filter_)
        self._put(target, name)

        def remove():
            filters.remove(filter_)
            self._put(target, name)

        return remove

    def _put(self, target, name) -> None:
        self.changes += 1
        original, was_own, filters, watchers = self._chains[id(target), name]
        if not filters and not watchers:
            del self._chains[id(target), name]
            if was_own:
                setattr(target, name, original)
            else:
                delattr(target, name)
            return
        call = original
        for filter_ in (*filters, *watchers):
            call = _Filtered(filter_, call)
        setattr(target, name, call)


class _Filtered:
    """A call through one filter."""

    __slots__ = ("call", "filter")

    def __init__(self, filter_, call):
        self.filter, self.call = filter_, call

    def __call__(self, *arguments):
        return self.filter(self.call, *arguments)
