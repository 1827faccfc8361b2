"""One page about a run: the animal in 3D, charts, tables; see `evo_cpg.view.page.document`."""
