"""`observation.picture` and `observation.stack` of study.yaml → observations, and the outline that a picture gives."""
