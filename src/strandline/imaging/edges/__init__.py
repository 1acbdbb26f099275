"""The edge in a picture: strips across it, ways to find it in each, and what makes one doubtful."""
