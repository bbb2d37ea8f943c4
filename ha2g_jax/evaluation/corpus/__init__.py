"""Statistics and HTML reports of a corpus."""
