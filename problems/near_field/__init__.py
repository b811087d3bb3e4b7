"""Near-field source localization: the measured data, and estimators of the sources."""
