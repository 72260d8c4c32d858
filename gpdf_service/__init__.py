"""Certified 3D trajectories on the ground, from Gaussian-process distance fields."""
