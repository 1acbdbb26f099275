"""A simulator of your own, run as a command: templates in, a result file out."""
