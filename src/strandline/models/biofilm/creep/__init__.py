"""A solid that creeps: Maxwell branches beside an elastic law, and the way through time."""
