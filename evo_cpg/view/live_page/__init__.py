"""The live page of a run: its curves, its champion and its population while it evolves."""
