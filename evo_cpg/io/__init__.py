"""Creatures, worlds, controllers and tasks from validated YAML files."""
