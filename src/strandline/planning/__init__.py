"""Which experiment to make next: what it can be expected to teach, and how likely it is to fail."""
