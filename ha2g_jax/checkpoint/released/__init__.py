"""Import of the weights that the authors of HA2G and Trimodal released, by `importing`; `table` has their names."""
