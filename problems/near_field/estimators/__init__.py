"""The near-field estimators: one formulation per file."""
