"""Films, plots and previews.

Nothing is imported here: VTK and matplotlib load with the module that needs them (`film`,
`preview`, `plots`), so that a training run never pays for them.
"""
