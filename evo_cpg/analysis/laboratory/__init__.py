"""Questions that an animal answers without evolution: open loop, cuts, other bodies, tow."""
