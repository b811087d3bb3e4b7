"""The objectives that are minimized, each with the equation it implements, and their compiled kernels."""
