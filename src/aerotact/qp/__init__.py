"""Quadratic programmes without a robot: the generated QP solvers called from Python."""
