"""Forward models: the built-in biofilm and adapters to other simulators.

In: values of the inputs. Out: a `Simulation` (the interface of each condition), or a `ForwardModelError` that says how
the run failed. What a model can do beyond this (sensitivities, fields), it says by the protocols in `protocol.py`.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.models.command.options import RUNS
    from strandline.models.fidelities import (
        CHEAPER,
        FIRST_PAIRS,
        WithCheaper,
        by_cheaper,
        first_runs,
        is_cheaper,
        run_identity,
    )
    from strandline.models.fields import WithFields, fields_of
    from strandline.models.identity import fingerprint
    from strandline.models.protocol import (
        ForwardModel,
        KeepsFolders,
        ModelInput,
        PreparesRuns,
        Sensitivities,
        Simulation,
        SolvesOnFinerMesh,
        UsesNames,
        asks_sensitivities,
        declared_conditions,
        declared_failure_kinds,
        declared_inputs,
        differentiated,
        draws_fields,
        prepare_runs,
        require_conditions,
        require_inputs,
        same_unit,
        undeformed_interface,
        vjp,
        with_option,
        with_sensitivities,
        without_failure_budget,
        without_sensitivities,
    )
    from strandline.models.python import PythonModel
else:
    __getattr__ = door(__name__, __file__)

__all__ = ["MODELS"]

MODELS = {
    "biofilm": "strandline.models.biofilm.model:Biofilm",
    "command": "strandline.models.command.model:CommandModel",
    "python": "strandline.models.python:PythonModel",
    "umbridge": "strandline.models.umbridge.model:UMBridgeModel",
}
"""Names in study files → ``module:class``, imported only when used."""
