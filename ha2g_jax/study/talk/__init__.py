"""Scores of a checkpoint on the Talk corpus, whose causes are known, and of recordings, where they are not."""
