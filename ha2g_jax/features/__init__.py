"""Read speech and words, and compute the features that models read: spectrograms, word indices, word vectors."""
