"""Forward runs: records, the ledger that keeps them, executors, campaigns."""
