"""A nervous system that lets its animal's motion depend on what it sees."""

from evo_cpg.control.controller import Command
from trials import SineController


class Watcher(SineController):
    """The sine wave with an offset of what the first eye sees more than the second."""

    def act(self, decoded, state, observation):
        state, command = super().act(decoded, state, observation)
        turn = 3.0 * (
            observation.light[0] - observation.light[1] + 0.2 * observation.vertical_sine[0]
        )
        return state, Command(command.target_rate + turn[None], command.signal)
