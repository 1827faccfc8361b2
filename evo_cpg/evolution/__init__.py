"""Searches for good genomes: genetic algorithms, maps of behaviour, evosax, islands."""
