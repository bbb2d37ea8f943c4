"""Import of the TED data sets in their original form: LMDB databases of values serialized by pyarrow 0.14."""
