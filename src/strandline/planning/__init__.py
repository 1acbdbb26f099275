"""Which experiment to make next: what it can be expected to teach, and whether it can be made."""
