"""How an instance becomes an estimate: one formulation per file."""
