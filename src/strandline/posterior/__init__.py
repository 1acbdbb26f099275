"""The posterior as weighted draws, and what is read off them."""
