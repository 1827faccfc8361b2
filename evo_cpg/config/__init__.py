"""YAML files to validated settings to creatures, worlds, controllers and tasks."""
