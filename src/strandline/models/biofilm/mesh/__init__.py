"""Outlines in the channel, the mesh between them, and how loads and outlines change with time."""
