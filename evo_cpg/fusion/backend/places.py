"""Places in memory, in bytes."""

from evo_cpg.fusion import machine_constants

FRAME_ORIGIN = 8192
"""Where the pointer to shared memory points to in it: AVX-512 tells offsets of up to 128 vectors in
one byte."""


class Places:
    """Hands out places.

    Attributes:
        size: bytes of scratch memory, which each vector has for itself.
        frame: bytes of shared memory. Vectors that take turns use the same, so that it stays in the
            cache.
    """

    def __init__(self):
        self._free: dict[int, list[int]] = {}
        self.size = self.frame = 0

    def room(self, size: int) -> int:
        """Return a place in scratch memory for good."""
        place = self.size
        self.size += _lines(size)
        return place

    def borrow(self, size: int) -> int:
        """Return a place in shared memory until it is given back, likely still in the cache."""
        free = self._free.get(size)
        if free:
            return free.pop()
        place = self.frame
        self.frame += _lines(size)
        return place

    def give_back(self, size: int, place: int) -> None:
        """Let a borrowed place be used for something else."""
        self._free.setdefault(size, []).append(place)


def _lines(size: int) -> int:
    """Round up to whole lines of the cache."""
    line = machine_constants.CACHE_LINE
    return -(-size // line) * line
