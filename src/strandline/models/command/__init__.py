"""A simulator of one's own, run as a command: templates in, a result file out."""
