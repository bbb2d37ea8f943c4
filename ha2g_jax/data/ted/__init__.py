"""The TED data sets in their original form: LMDB databases of what pyarrow 0.14 serialized."""
