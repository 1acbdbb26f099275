"""Forward models: the built-in biofilm and adapters to other simulators."""
