"""Read speech and words, and compute the features that models take: spectrograms, word indices, word vectors."""
