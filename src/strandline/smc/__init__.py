"""Adaptive tempered Sequential Monte Carlo.

In: a prior to draw from, a log-likelihood in batches, a random key. Out: weighted particles and a record of each step.
"""

from strandline.smc.combined import ConditionalLogDensity, carried_over, in_halves, joined, sample_each
from strandline.smc.hamiltonian import LEAPS, Chains, hamiltonian
from strandline.smc.moves import BatchedLogDensity, Moved, RandomKey, metropolis
from strandline.smc.on_host import OnHost, is_on_host
from strandline.smc.records import STUDY, SMCResult, SMCSettings, StepInfo, require
from strandline.smc.sampler import sample
from strandline.smc.steps import Particles, systematic
from strandline.smc.tempering import effective_sample_size, next_temperature

__all__ = [
    "LEAPS",
    "STUDY",
    "BatchedLogDensity",
    "Chains",
    "ConditionalLogDensity",
    "Moved",
    "OnHost",
    "Particles",
    "RandomKey",
    "SMCResult",
    "SMCSettings",
    "StepInfo",
    "carried_over",
    "effective_sample_size",
    "hamiltonian",
    "in_halves",
    "is_on_host",
    "joined",
    "metropolis",
    "next_temperature",
    "sample",
    "sample_each",
    "systematic",
]
