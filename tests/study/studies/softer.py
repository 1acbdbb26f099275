"""A cheaper model for studies: the beam with a modulus that is too small by a tenth."""

from collections.abc import Mapping
from pathlib import Path

from strandline.models.protocol import Simulation
from strandline.testing.studies import beam


class Softer:
    fingerprint = "test:softer-beam"
    inputs = beam.inputs

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        return beam({**inputs, "E": 0.9 * inputs["E"]}, workdir)


softer = Softer()
