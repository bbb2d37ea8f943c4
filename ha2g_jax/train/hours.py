"""Predict how long a run takes on the machine at hand, from a measured step, and the runs of Table 1 together."""
