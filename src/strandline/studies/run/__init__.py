"""A study run from its design to its results, and what is wrong with one that did not get there."""
