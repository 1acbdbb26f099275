"""Every run ever made, in one SQLite file: its schema, its rows, who holds it, and an overview without loading it."""
