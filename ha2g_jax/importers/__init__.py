"""Importers that make a corpus from recordings of people: TED files, motion capture or videos."""
