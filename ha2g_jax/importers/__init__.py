"""Importers: recordings of people, as TED files, motion capture or videos, become a corpus."""
