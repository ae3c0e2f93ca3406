"""Timing and accuracy of the generated real-time iteration beside its peers, on the same quadratic programmes."""
