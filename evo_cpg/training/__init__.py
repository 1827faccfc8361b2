"""The generation loop, its sharding over cores, run folders and checkpoints."""
