"""Analysis of evolved animals: gaits, energy and rhythms."""
