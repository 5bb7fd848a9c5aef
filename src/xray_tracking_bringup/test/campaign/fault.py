"""What a fault is, and what may come of it."""
import dataclasses
from typing import Callable

# What must come of a fault.
CLOSES = "closed while it lasts"
CLOSES_ONCE = "closed"
RIGHT = "poses right"
NEVER_OPENS = "never open"
UNSEEN = "cannot be seen"

ITSELF = "by itself"


@dataclasses.dataclass
class Fault:
    """`inject(rig, random)` begins it. @return (how to end it, or None; its strength in words)"""
    name: str
    words: str
    must: str
    inject: Callable
    seconds: tuple = (1.0, 3.0)  # how long it lasts
    recovery: str = ITSELF
    recovery_s: float = 15.0     # by then the gate is open again
    graph: str = "plain"         # plain; interposed, sim_time, record: see campaign.launch; started: before the graph is
    dies: tuple = ()             # nodes that it ends
    begins_anew: bool = False    # the patient is taken to be at the initial pose behind it


FAULTS = {}


def fault(words, must, **options):
    def add(inject):
        FAULTS[inject.__name__] = Fault(inject.__name__, words, must, inject, **options)
        return inject
    return add


def ends_graph(fault):
    """Whether another graph has to be started behind it."""
    return fault.name == "master_dies"
