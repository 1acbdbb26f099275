"""Forward models: the built-in biofilm and adapters to other simulators."""

from strandline.errors import InvalidInput

__all__ = ["MODELS", "refused"]

MODELS = {
    "biofilm": "strandline.models.biofilm.model:Biofilm",
    "command": "strandline.models.command.model:CommandModel",
    "python": "strandline.models.python:PythonModel",
    "umbridge": "strandline.models.umbridge.model:UMBridgeModel",
}
"""Names in study files → ``module:class``, imported only when used."""


def refused(what: str, value: object, expected: str, remedy: str = "Correct it.") -> InvalidInput:
    """Return the error for an option of a model that cannot be used."""
    return InvalidInput(what, value=value, expected=expected, remedy=remedy)
