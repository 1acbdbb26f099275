"""Study folders: the YAML schema, loading, results."""
