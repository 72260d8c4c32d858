"""Measurements: accuracy, speed and safety, each beside a peer or an independent judge in the same run."""
