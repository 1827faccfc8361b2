"""World, creature and controller together: rollouts, sensors, tasks."""
