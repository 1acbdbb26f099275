"""Many specimens: the posterior of each through one surrogate, and the population that they come from."""

from strandline.population.certificate import TOLERATED_SHIFT, Certified
from strandline.population.hierarchy import FEWEST_SPECIMENS, Population, population_of
from strandline.population.many import Refused, Task, posteriors_of
from strandline.population.shrinkage import Shrunk, shrunk
from strandline.population.specimen import SpecimenPosterior, posterior_of
from strandline.population.start import Start, require_given, start

__all__ = [
    "FEWEST_SPECIMENS",
    "TOLERATED_SHIFT",
    "Certified",
    "Population",
    "Refused",
    "Shrunk",
    "SpecimenPosterior",
    "Start",
    "Task",
    "population_of",
    "posterior_of",
    "posteriors_of",
    "require_given",
    "shrunk",
    "start",
]
