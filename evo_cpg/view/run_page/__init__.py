"""One page about a run: the animal in 3D, charts and tables (`evo_cpg.view.run_page.document`)."""
