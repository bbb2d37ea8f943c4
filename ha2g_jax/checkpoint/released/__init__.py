"""Import the weights that the authors of HA2G and Trimodal released: `table` has their names, `importing` the entry."""
