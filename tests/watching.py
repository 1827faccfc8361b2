"""A controller whose commands depend on the light sensors."""

from evo_cpg.control.controller import Command
from trials import SineController


class Watcher(SineController):
    """Sine wave with an offset by the difference of both light sensors and by the tilt."""

    def act(self, decoded, state, observation):
        state, command = super().act(decoded, state, observation)
        turn = 3.0 * (
            observation.light[0] - observation.light[1] + 0.2 * observation.vertical_sine[0]
        )
        return state, Command(command.target_rate + turn[None], command.signal)
