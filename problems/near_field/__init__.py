"""Near-field source localization: what is measured, and how sources are estimated from it."""
