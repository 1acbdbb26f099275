"""The content of study.yaml and the files that it names → the parts of a study → a `Study`."""
