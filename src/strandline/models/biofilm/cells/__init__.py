"""Flow cells solved: steady, in time, creeping, from anchors near the inputs; fields of their flow."""
