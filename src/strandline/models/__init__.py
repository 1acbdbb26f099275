"""Forward models: the built-in biofilm and adapters to other simulators."""

MODELS = {
    "biofilm": "strandline.models.biofilm.model:Biofilm",
    "command": "strandline.models.command.model:CommandModel",
    "python": "strandline.models.python:PythonModel",
    "umbridge": "strandline.models.umbridge.model:UMBridge",
}
"""Names in study files → ``module:class``, imported only when used."""
