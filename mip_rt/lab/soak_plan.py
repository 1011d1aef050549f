"""Draws what happens in one run of a campaign: an operator who drives, spins, disarms and recovers, and faults at random moments.

The plan is an ordinary scenario: written to a file, it replays the run with `mip-rt --dry-run`.
"""

import random

from mip_rt.config.scenario import Event, Scenario
from mip_rt.fake.faults import FAULTS, defaults, drawn

FIRST_FAULT_S = 5.0
LAST_FAULT_S = 10.0  # before the end: every run must end balancing
SPEED_M_S = 0.2


def _manoeuvre(source, levels, at_s: float, moving: bool) -> Event:
    level = source.choice(levels)
    reach = source.uniform(0.05 if moving else 0.0, min(SPEED_M_S, level.drive_limit_m_s))
    directions = ((1, 0), (-1, 0), (0, 1), (0, -1), (0.7, 0.7), (-0.7, 0.7), (0, 0))
    forward, left = source.choice(directions[:-1] if moving else directions)
    return Event(round(at_s, 3), level.yaw_rate_hz, [round(reach * forward, 3), round(reach * left, 3)])


def _recovery(at_s: float) -> list[Event]:
    return [Event(round(at_s, 3), 0.0, [0.0, 0.0]), Event(round(at_s + 0.3, 3), press="recover")]


def plan(seed: int, duration_s: float, levels, names=None, shipped_values: bool = False, gap_s=(3.0, 7.0)) -> Scenario:
    """One run's scenario.

    Args:
        levels: the remote's levels.
        names: faults to draw from; None for all that have a weight.
        shipped_values: faults with their shipped parameters (and a random wheel), one at a time, as for the table of bounds.
        gap_s: time between a fault's end and the next one.
    """
    source = random.Random(f"campaign {seed}")
    names = list(names) if names is not None else [name for name, kind in FAULTS.items() if kind.weight]
    weights = [max(FAULTS[name].weight, 1) for name in names]
    events = [Event(2.0, press="arm")]
    at_s = FIRST_FAULT_S
    while at_s < duration_s - LAST_FAULT_S:
        events.append(_manoeuvre(source, levels, at_s - 1.8, shipped_values))
        name = source.choices(names, weights)[0]
        parameters = drawn(name, source)
        if shipped_values:
            parameters = {**defaults(name), **{key: parameters[key] for key in ("wheel", "axis", "text", "error") if key in parameters}}
        events.append(Event(round(at_s, 3), fault=name, parameters=parameters))
        end_s = at_s + parameters.get("for_s", parameters.get("stall_s", 0.0))
        if not shipped_values and source.random() < 0.2:  # two at once
            second = source.choices(names, weights)[0]
            more = drawn(second, source)
            second_s = source.uniform(at_s, end_s)
            events.append(Event(round(second_s, 3), fault=second, parameters=more))
            end_s = max(end_s, second_s + more.get("for_s", more.get("stall_s", 0.0)))
        if not shipped_values and source.random() < 0.1:
            events.append(Event(round(source.uniform(at_s, end_s + 0.3), 3), press=source.choice(("disarm", "heading_reset"))))
        events += _recovery(end_s + source.uniform(1.2, 1.8))
        at_s = end_s + 4.0 + source.uniform(*gap_s)
    events.append(Event(duration_s - 8.0, 0.0, [0.0, 0.0]))
    events += _recovery(duration_s - 7.0)
    return Scenario(f"soak-seed{seed}", f"campaign run of seed {seed}", duration_s, sorted(events, key=lambda event: event.at_s))
